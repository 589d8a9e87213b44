"use strict";
const LDC = {
  data: JSON.parse(document.getElementById("data").textContent),
  types: {f4: Float32Array, i4: Int32Array, i2: Int16Array, u2: Uint16Array, i1: Int8Array, u1: Uint8Array},
  svg: (document.querySelector("svg") || document.body).namespaceURI,
  numbers(packed) {
    const raw = atob(packed.data), bytes = new Uint8Array(raw.length);
    for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
    return new LDC.types[packed.type](bytes.buffer);
  },
  element(name, attributes, text) {
    const svg = ["svg", "path", "text", "circle", "g", "title"].includes(name);
    const made = svg ? document.createElementNS(LDC.svg, name) : document.createElement(name);
    for (const [key, value] of Object.entries(attributes || {})) made.setAttribute(key, value);
    if (text !== undefined) made.textContent = text;
    return made;
  },
};
document.documentElement.classList.add("script");
// a link to something inside closed details opens them
addEventListener("hashchange", () => {
  const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
  const closed = target && target.closest("details");
  if (closed) closed.open = true;
});
