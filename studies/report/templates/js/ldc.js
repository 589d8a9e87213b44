// The page's script: what its parts share. The page reads without it.
"use strict";
var LDC = (function () {
  var TYPES = { f4: [4, "getFloat32"], i4: [4, "getInt32"], i2: [2, "getInt16"], u2: [2, "getUint16"], i1: [1, "getInt8"], u1: [1, "getUint8"] };
  var MINUS = "\u2212";
  var GREEK = { alpha: "α", beta: "β", delta: "δ", kappa: "κ", lambda: "λ", mu: "μ", omega: "ω", phi: "φ", psi: "ψ", rho: "ρ", sigma: "σ", theta: "θ" };
  var SYMBOL = /(^|[^A-Za-z0-9_])([A-Za-z]|sigma|delta|psi|rho|lambda)_([A-Za-z0-9]{1,5}(?:_[A-Za-z0-9]{1,4})?)(?![A-Za-z0-9_])/g;
  var holder = document.createElement("template");
  holder.innerHTML = "<svg></svg>";  // asks the browser for the namespace: its name is an address
  var SVG = holder.content.firstChild.namespaceURI;
  var all = JSON.parse(document.getElementById("ldc-data").textContent);

  // A packed array as an array of numbers, whatever the machine's byte order.
  function numbers(packed) {
    var bytes = atob(packed.data), size = TYPES[packed.type][0], read = TYPES[packed.type][1];
    var view = new DataView(new ArrayBuffer(bytes.length));
    for (var i = 0; i < bytes.length; i++) view.setUint8(i, bytes.charCodeAt(i));
    var found = new Array(bytes.length / size);
    for (var k = 0; k < found.length; k++) found[k] = view[read](k * size, true);
    return found;
  }

  // Text of a number, as the page's own text has it.
  function number(value, digits) {
    if (Number.isNaN(value) || value === null || value === undefined) return "–";
    if (!Number.isFinite(value)) return value > 0 ? "∞" : MINUS + "∞";
    var shown = value.toFixed(digits === undefined ? 3 : digits);
    if (Number(shown) === 0) shown = shown.replace("-", "");
    return shown.replace("-", MINUS);
  }
  function signed(value, digits) {
    var shown = number(value, digits);
    return Number.isFinite(value) && value > 0 && Number(value.toFixed(digits === undefined ? 3 : digits)) !== 0 ? "+" + shown : shown;
  }
  function percent(value, digits) {
    return number(100 * value, digits === undefined ? 1 : digits) + "\u00a0%";
  }

  function fill(node, attributes, children) {
    Object.keys(attributes || {}).forEach(function (name) {
      var value = attributes[name];
      if (typeof value === "function") node.addEventListener(name, value);
      else if (value === true) node.setAttribute(name, "");
      else if (value !== false && value !== null && value !== undefined) node.setAttribute(name, value);
    });
    (Array.isArray(children) ? children : children === undefined ? [] : [children]).forEach(function (child) {
      node.appendChild(typeof child === "object" ? child : document.createTextNode(String(child)));
    });
    return node;
  }
  // An element with attributes (functions are listeners) and children (text or nodes): never markup.
  function el(tag, attributes, children) { return fill(document.createElement(tag), attributes, children); }
  function svg(tag, attributes, children) { return fill(document.createElementNS(SVG, tag), attributes, children); }

  // Text in which K_psi is set as a letter with an index.
  function symbols(text) {
    var parts = document.createDocumentFragment(), end = 0, match;
    SYMBOL.lastIndex = 0;
    while ((match = SYMBOL.exec(text)) !== null) {
      parts.appendChild(document.createTextNode(text.slice(end, match.index) + match[1] + (GREEK[match[2]] || match[2])));
      parts.appendChild(el("sub", {}, match[3].split("_").map(function (one) { return GREEK[one] || one; }).join(", ")));
      end = SYMBOL.lastIndex;
    }
    parts.appendChild(document.createTextNode(text.slice(end)));
    return parts;
  }

  document.documentElement.classList.add("script");
  return {
    // What a section handed over, or undefined.
    data: function (section) { return all[section]; },
    numbers: numbers, number: number, signed: signed, percent: percent, el: el, svg: svg, symbols: symbols
  };
})();
