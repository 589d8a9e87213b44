// What a reader's eye would see, measured in the page: text over text, cut text, sideways scrolling.
(() => {
  const shown = (e) =>
    e.checkVisibility({ visibilityProperty: true, opacityProperty: true, contentVisibilityAuto: true });
  const told = (e, box) => {
    const part = e.closest("section, nav, header, footer, dialog, aside") || document.body;
    const words = (e.textContent || e.getAttribute("aria-label") || "").trim().replace(/\s+/g, " ").slice(0, 50);
    const at = [box.left, box.top].map(Math.round), size = [box.right - box.left, box.bottom - box.top].map(Math.round);
    return `${part.id || part.localName} ${e.localName} "${words}" at ${at} size ${size}`;
  };

  // What of a box can be seen inside the boxes that clip it.
  const clipped = (e, box) => {
    let { left, top, right, bottom } = box;
    for (let p = e; p && p !== document.body; p = p.parentElement) {
      const style = getComputedStyle(p);
      if (style.overflowX === "visible" && style.overflowY === "visible" && style.clipPath === "none") continue;
      if (p.namespaceURI.endsWith("svg") && p.localName !== "svg") continue;
      const r = p.getBoundingClientRect();
      left = Math.max(left, r.left);
      right = Math.min(right, r.right);
      top = Math.max(top, r.top);
      bottom = Math.min(bottom, r.bottom);
    }
    return { left, top, right, bottom };
  };

  // Text that stands neither level nor upright has a box far larger than itself.
  const oblique = (e) => {
    const matrix = e.closest("svg text") && e.getScreenCTM();
    return matrix && Math.abs(matrix.a) > 0.05 && Math.abs(matrix.b) > 0.05;
  };

  function overlaps() {
    const boxes = [];
    const add = (e, rect) => {
      const box = clipped(e, rect);
      if (box.right - box.left > 2 && box.bottom - box.top > 2) boxes.push({ e, ...box });
    };
    const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
    for (let node = walker.nextNode(); node; node = walker.nextNode()) {
      const parent = node.parentElement;
      if (!node.data.trim() || parent.closest("script, style, title, desc, option, template")) continue;
      if (!shown(parent) || oblique(parent)) continue;
      const range = document.createRange();
      range.selectNodeContents(node);
      for (const rect of range.getClientRects()) add(parent, rect);
    }
    for (const e of document.querySelectorAll("button, input, select, textarea, summary")) {
      if (shown(e)) add(e, e.getBoundingClientRect());
    }
    boxes.sort((a, b) => a.top - b.top);
    const found = [];
    boxes.forEach((a, i) => {
      for (let k = i + 1; k < boxes.length && boxes[k].top < a.bottom; k++) {
        const b = boxes[k];
        if (a.e === b.e || a.e.contains(b.e) || b.e.contains(a.e)) continue;
        const wide = Math.min(a.right, b.right) - Math.max(a.left, b.left);
        const high = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
        // line boxes are higher than their letters: an index or a tight line shares a few pixels with its neighbour
        const least = Math.min(a.bottom - a.top, b.bottom - b.top);
        if (wide > 2 && high > Math.max(3, 0.35 * least)) found.push(`${told(a.e, a)} over ${told(b.e, b)}`);
      }
    });
    return found;
  }

  function cut() {
    const found = [], hides = (value) => value === "hidden" || value === "clip";
    for (const e of document.querySelectorAll("body *")) {
      if (!shown(e) || e.closest("svg")) continue;
      const style = getComputedStyle(e), box = e.getBoundingClientRect();
      if (box.width <= 2 || box.height <= 2) continue;  // for screen readers only
      if (hides(style.overflowX) && e.scrollWidth > e.clientWidth + 1) found.push(`cut sideways: ${told(e, box)}`);
      if (hides(style.overflowY) && e.scrollHeight > e.clientHeight + 1) found.push(`cut below: ${told(e, box)}`);
    }
    for (const e of document.querySelectorAll("select, button")) {
      if (shown(e) && e.scrollWidth > e.clientWidth + 2) found.push(`cut: ${told(e, e.getBoundingClientRect())}`);
    }
    for (const e of document.querySelectorAll("svg text")) {
      if (!shown(e) || !e.textContent.trim()) continue;
      const t = e.getBoundingClientRect(), s = e.ownerSVGElement.getBoundingClientRect();
      if (t.width && (t.left < s.left - 1 || t.right > s.right + 1 || t.top < s.top - 1 || t.bottom > s.bottom + 1)) {
        found.push(`outside its drawing: ${told(e, t)}`);
      }
    }
    return found;
  }

  function sideways() {
    const found = [], width = document.documentElement.clientWidth;
    const over = document.documentElement.scrollWidth - width;
    if (over > 0) found.push(`the page is ${over} px too wide`);
    for (const e of document.querySelectorAll("body *")) {
      if (!shown(e) || e.parentElement.closest("svg")) continue;
      const seen = clipped(e.parentElement, e.getBoundingClientRect());
      if (seen.right > width + 0.5 && seen.right > seen.left) found.push(`too wide: ${told(e, seen)}`);
    }
    return found;
  }

  function small() {
    return Array.from(document.querySelectorAll("main .panel svg[role=img]")).flatMap((e) => {
      const box = e.getBoundingClientRect();
      return box.width && (box.width < 200 || box.height < 80) ? [`small drawing: ${told(e, box)}`] : [];
    });
  }

  // Words of ordinary length whose letters stand on two lines; a hyphen or a slash ends a word.
  function broken() {
    const found = [], walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
    for (let node = walker.nextNode(); node; node = walker.nextNode()) {
      const e = node.parentElement;
      if (e.closest("script, style, svg, option, template, pre, code") || !shown(e)) continue;
      for (const word of node.data.matchAll(/(?<![\p{L}\p{N}_.,])[\p{L}\p{N}_.,]{2,24}(?![\p{L}\p{N}_.,])/gu)) {
        const range = document.createRange();
        range.setStart(node, word.index);
        range.setEnd(node, word.index + word[0].length);
        const lines = Array.from(range.getClientRects()).filter((r) => r.width > 0);
        if (lines.some((r) => r.top > lines[0].bottom - 2)) {
          found.push(`broken word ${word[0]}: ${told(e, range.getBoundingClientRect())}`);
        }
      }
    }
    return found;
  }

  return [sideways, overlaps, cut, small, broken].flatMap((look) => look().slice(0, 20));
})();
