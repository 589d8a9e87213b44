// Scatter of any two figures: choice of axes, laws to show or hide, front, points to point at and to open.
(function () {
  "use strict";
  var designs = LDC.designs, home = document.getElementById("trade-offs-plot"), start = LDC.data("trade-offs");
  if (!designs || !home || !start) return;
  var el = LDC.el, svg = LDC.svg, axes = LDC.axes, R = 4, INK = "#333";
  var hidden = {}, points = [], current = -1, cursor = null, width = 0;

  function choice(id, name) {
    var groups = designs.data.groups;
    return el("select", { id: id, change: function () { relog(); draw(); } }, Object.keys(groups).map(function (group) {
      return el("optgroup", { label: groups[group] }, designs.figures.filter(function (one) { return one.group === group; })
        .map(function (one) {
          return el("option", { value: one.name, selected: one.name === name }, designs.axis(one) + (one.better === "more" ? " (more is better)" : ""));
        }));
    }));
  }
  function box(title, act) {
    var input = el("input", { type: "checkbox", change: act });
    return { input: input, label: el("label", {}, [input, " ", title]) };
  }
  var x = choice("trade-offs-x", start.x), y = choice("trade-offs-y", start.y);
  var logX = box("logarithmic", draw), logY = box("logarithmic", draw), everything = box("all points", draw);
  logX.input.setAttribute("aria-label", "Horizontal axis logarithmic");
  logY.input.setAttribute("aria-label", "Vertical axis logarithmic");
  var swap = el("button", { type: "button", click: function () {
    var name = x.value, on = logX.input.checked;
    x.value = y.value;
    y.value = name;
    logX.input.checked = logY.input.checked;
    logY.input.checked = on;
    relog();
    draw();
  } }, "Swap axes");
  var legend = el("ul", { "class": "legend laws", "aria-label": "Laws" });
  var panel = el("div", { "class": "panel plot" }), tip = el("div", { "class": "tip", hidden: true });
  var about = el("span", {}), note = el("p", { "class": "small", role: "status", id: "trade-offs-note" });
  var spoken = el("p", { "class": "spoken", "aria-live": "polite" });
  home.appendChild(el("div", { "class": "controls", role: "group", "aria-label": "Axes of the scatter" }, [
    el("label", { "for": "trade-offs-y" }, ["Vertical ", y]), logY.label, el("label", { "for": "trade-offs-x" }, ["Horizontal ", x]), logX.label,
    swap, everything.label
  ]));
  home.appendChild(legend);
  home.appendChild(el("div", { "class": "holder" }, [panel, tip]));
  home.appendChild(note);
  home.appendChild(spoken);
  home.appendChild(el("p", { "class": "small" }, ["A point opens its design. With the keyboard: arrow keys go from point to point along the horizontal axis, Enter opens. Laws in the legend can be switched off. ", about]));

  function scaled(name) {
    var one = designs.described(name), values = designs.figure(name);
    return function (i) { return values[i] * one.scale; };
  }
  function wide(of) {
    var low = Infinity, high = -Infinity;
    for (var i = 0; i < designs.count; i++) {
      var value = of(i);
      if (Number.isFinite(value)) { low = Math.min(low, value); high = Math.max(high, value); }
    }
    return low > 0 && high > 10 * low;
  }
  function relog() {
    [[x, logX], [y, logY]].forEach(function (one) {
      var can = wide(scaled(one[0].value));
      one[1].input.disabled = !can;
      one[1].label.title = can ? "" : "For figures above zero that differ by more than ten times";
      if (!can) one[1].input.checked = false;
    });
  }
  function said(i) {
    var one = designs.described(x.value), other = designs.described(y.value);
    return [designs.place(i).label.replace(/-(?=\d)/g, "\u2212"), designs.rank(i) ? "rank " + designs.rank(i) : "not ranked",
      designs.titled(one) + " " + designs.shown(one.name, i), designs.titled(other) + " " + designs.shown(other.name, i)];
  }
  function point(k) {
    current = k;
    var one = points[k], lines = said(one.place);
    cursor.setAttribute("transform", "translate(" + one.x.toFixed(1) + " " + one.y.toFixed(1) + ")");
    cursor.setAttribute("aria-label", lines.join("; ") + "; open the design");
    while (tip.firstChild) tip.removeChild(tip.firstChild);
    lines.forEach(function (line, n) { tip.appendChild(el(n ? "div" : "b", {}, LDC.symbols(line))); });
    tip.hidden = false;
    var left = Math.min(Math.max(one.x - tip.offsetWidth / 2, 0), Math.max(0, width - tip.offsetWidth));
    tip.style.left = left + "px";
    tip.style.top = one.y - tip.offsetHeight - 12 > 0 ? one.y - tip.offsetHeight - 8 + "px" : one.y + 22 + "px";
  }
  function leave() {
    tip.hidden = true;
    cursor.classList.remove("near");
  }
  function nearest(event) {
    var frame = panel.firstChild.getBoundingClientRect(), px = event.clientX - frame.left, py = event.clientY - frame.top;
    var found = -1, least = 18 * 18;
    points.forEach(function (one, k) {
      var far = (one.x - px) * (one.x - px) + (one.y - py) * (one.y - py);
      if (far < least) { least = far; found = k; }
    });
    return found;
  }
  function open(k) {
    cursor.focus();
    designs.choose(points[k].place);
  }
  function key(event) {
    var steps = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1, PageDown: 10, PageUp: -10, Home: -Infinity, End: Infinity };
    if (event.key === "Enter" || event.key === " ") {
      event.preventDefault();
      open(current);
    } else if (steps[event.key]) {
      event.preventDefault();
      point(Math.min(Math.max(current + steps[event.key], 0), points.length - 1));
      spoken.textContent = said(points[current].place).join("; ");
    }
  }

  function text(at, content, attributes) {
    return svg("text", Object.assign({ x: at[0], y: at[1], fill: INK, "font-size": 12 }, attributes), LDC.symbols(content));
  }
  // Letters with an index: HTML's sub does not work in a drawing.
  function label(at, content, attributes) {
    var node = text(at, "", attributes);
    node.textContent = "";
    LDC.symbols(content).childNodes.forEach(function (child) {
      if (child.nodeName === "SUB") {
        node.appendChild(svg("tspan", { dy: "0.22em", "font-size": "78%" }, child.textContent));
        node.appendChild(svg("tspan", { dy: "-0.17em" }, "\u200b"));
      } else node.appendChild(svg("tspan", {}, child.textContent));
    });
    return node;
  }
  function draw() {
    var X = scaled(x.value), Y = scaled(y.value), one = designs.described(x.value), other = designs.described(y.value);
    var lx = logX.input.checked, ly = logY.input.checked, was = points[current] && points[current].place;
    var shown = [], without = 0, k;
    for (k = 0; k < designs.count; k++) {
      if (!hidden[designs.law(k)]) {
        if (Number.isFinite(X(k)) && Number.isFinite(Y(k))) shown.push(k);
        else without++;
      }
    }
    width = Math.max(260, panel.clientWidth - 2);
    var height = Math.round(Math.min(460, Math.max(300, 0.6 * width))), left = 58, right = 14, top = 14, bottom = 46;
    while (panel.firstChild) panel.removeChild(panel.firstChild);
    tip.hidden = true;
    points = [];
    current = -1;
    if (!shown.length) {
      panel.appendChild(el("p", { "class": "note" }, "No design that is shown has both figures."));
      note.textContent = "";
      return;
    }
    var ranked = shown.filter(function (i) { return designs.rank(i) > 0; }), signs = [one, other].map(function (f) { return f.better === "less" ? 1 : -1; });
    var front = axes.front(ranked.length ? ranked : shown, function (i) { return [signs[0] * X(i), signs[1] * Y(i)]; });
    var kept = front.concat([designs.winner, designs.baseline].filter(function (i) { return shown.indexOf(i) >= 0 && !designs.is("passive", i); }));
    var spanX = axes.range(shown.map(X), kept.map(X), everything.input.checked, lx);
    var spanY = axes.range(shown.map(Y), kept.map(Y), everything.input.checked, ly);
    function at(value, span, log, from, to) { return from + ((log ? Math.log10(value) : value) - span[0]) / (span[1] - span[0]) * (to - from); }
    function px(value) { return at(value, spanX, lx, left, width - right); }
    function py(value) { return at(value, spanY, ly, height - bottom, top); }
    var drawing = svg("svg", {
      viewBox: "0 0 " + width + " " + height, width: width, height: height, role: "group",
      "aria-label": other.title + " over " + one.title + ", one point a design"
    });
    axes.ticks(spanX, lx, Math.max(3, Math.floor(width / 90))).forEach(function (tick) {
      var place = left + (tick.at - spanX[0]) / (spanX[1] - spanX[0]) * (width - left - right);
      drawing.appendChild(svg("path", { d: "M" + place.toFixed(1) + " " + top + "V" + (height - bottom), stroke: "#e3e3e3", fill: "none" }));
      drawing.appendChild(text([place.toFixed(1), height - bottom + 16], tick.text, { "text-anchor": "middle" }));
    });
    axes.ticks(spanY, ly, 6).forEach(function (tick) {
      var place = height - bottom - (tick.at - spanY[0]) / (spanY[1] - spanY[0]) * (height - bottom - top);
      drawing.appendChild(svg("path", { d: "M" + left + " " + place.toFixed(1) + "H" + (width - right), stroke: "#e3e3e3", fill: "none" }));
      drawing.appendChild(text([left - 6, (place + 4).toFixed(1)], tick.text, { "text-anchor": "end" }));
    });
    drawing.appendChild(svg("path", { d: "M" + left + " " + top + "V" + (height - bottom) + "H" + (width - right), stroke: "#767676", fill: "none" }));
    drawing.appendChild(label([(left + width - right) / 2, height - 8], designs.axis(one), { "text-anchor": "middle" }));
    drawing.appendChild(label([0, 0], designs.axis(other), { "text-anchor": "middle", transform: "translate(14 " + (top + height - bottom) / 2 + ") rotate(-90)" }));
    if (front.length > 1) {
      drawing.appendChild(svg("path", {
        d: front.map(function (i, n) { return n ? "H" + px(X(i)).toFixed(1) + "V" + py(Y(i)).toFixed(1) : "M" + px(X(i)).toFixed(1) + " " + py(Y(i)).toFixed(1); }).join(""),
        stroke: "#222", "stroke-width": 1.3, fill: "none", "class": "front"
      }));
    }
    var outside = 0, paths = designs.laws.map(function () { return []; });
    shown.forEach(function (i) {
      var cx = px(X(i)), cy = py(Y(i));
      if (cx < left - 1 || cx > width - right + 1 || cy < top - 1 || cy > height - bottom + 1) outside++;
      else {
        points.push({ place: i, x: cx, y: cy });
        paths[designs.law(i)].push(axes.marker(LDC.styles[designs.laws[designs.law(i)].name].marker, cx, cy, R));
      }
    });
    paths.forEach(function (parts, law) {
      if (parts.length) drawing.appendChild(svg("path", { d: parts.join(""), fill: LDC.styles[designs.laws[law].name].color, "fill-opacity": 0.8, stroke: INK, "stroke-width": 0.5, "data-law": designs.laws[law].name }));
    });
    [[designs.winner, "winner"], [designs.baseline, "baseline"]].forEach(function (special) {
      var found = points.filter(function (p) { return p.place === special[0]; })[0];
      if (!found) return;
      drawing.appendChild(svg("circle", { cx: found.x.toFixed(1), cy: found.y.toFixed(1), r: 8, fill: "none", stroke: "#222", "stroke-width": 1.5 }));
      var end = found.x > width - 90;
      drawing.appendChild(text([(found.x + (end ? -11 : 11)).toFixed(1), (found.y < top + 16 ? found.y + 16 : found.y - 7).toFixed(1)], special[1], { "text-anchor": end ? "end" : "start", "class": "name" }));
    });
    points.sort(function (a, b) { return a.x - b.x || b.y - a.y || a.place - b.place; });
    cursor = svg("g", { role: "button", tabindex: "0", "class": "cursor", keydown: key, focus: function () { point(current); }, blur: leave },
      svg("circle", { r: 10, fill: "none", stroke: "#0b5cad", "stroke-width": 2.5 }));
    drawing.appendChild(cursor);
    drawing.addEventListener("pointermove", function (event) {
      var k = nearest(event);
      if (k < 0) return document.activeElement === cursor ? undefined : leave();
      cursor.classList.add("near");
      point(k);
    });
    drawing.addEventListener("pointerleave", function () { if (document.activeElement !== cursor) leave(); });
    drawing.addEventListener("click", function (event) { var k = nearest(event); if (k >= 0) { point(k); open(k); } });
    panel.appendChild(drawing);
    about.textContent = "Line: no design shown " + (designs.data.require.length && ranked.length ? "that meets the requirements " : "") + "is as good in both figures and better in one.";
    var first = points.findIndex(function (p) { return p.place === (was === undefined ? designs.winner : was); });
    point(Math.max(0, first));
    leave();
    note.textContent = points.length.toLocaleString("en") + " of " + designs.count.toLocaleString("en") + (designs.count === 1 ? " design" : " designs") + " shown, " + front.length + " on the front."
      + (outside ? " " + outside.toLocaleString("en") + (outside === 1 ? " lies" : " lie") + " outside of these axes; \u201call points\u201d brings them in." : "")
      + (without ? " " + without.toLocaleString("en") + (without === 1 ? " has" : " have") + " no value of one of the figures." : "");
  }

  designs.laws.forEach(function (law, k) {
    var style = LDC.styles[law.name], sample = svg("svg", { "class": "sample", viewBox: "0 0 16 16", width: 16, height: 16, "aria-hidden": "true" },
      svg("path", { d: axes.marker(style.marker, 8, 8, 5), fill: style.color }));
    legend.appendChild(el("li", {}, el("button", { type: "button", "aria-pressed": "true", click: function (event) {
      hidden[k] = !hidden[k];
      event.currentTarget.setAttribute("aria-pressed", String(!hidden[k]));
      draw();
    } }, [sample, " ", LDC.symbols(law.title)])));
  });
  relog();
  draw();
  if (window.ResizeObserver) {
    new ResizeObserver(function () {
      if (Math.abs(Math.max(260, panel.clientWidth - 2) - width) > 1) draw();
    }).observe(panel);
  }
})();
