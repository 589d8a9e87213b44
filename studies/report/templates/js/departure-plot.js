// The drawing of one departure: position, steering angle and lateral acceleration over time, with a cursor.
(function () {
  "use strict";
  var LEFT = 58, RIGHT = 14, LIMIT = 3;

  // Round numbers between two ends.
  function ticks(low, high, most) {
    var raw = (high - low) / most, power = Math.pow(10, Math.floor(Math.log10(raw)));
    var step = [1, 2, 5, 10].map(function (one) { return one * power; }).find(function (one) { return one >= raw * 0.999; });
    var found = [];
    for (var i = Math.ceil(low / step - 1e-9); i <= high / step + 1e-9; i++) found.push(i * step);
    found.digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    return found;
  }

  function range(values, least, margin) {
    var low = Infinity, high = -Infinity;
    values.forEach(function (one) { if (Number.isFinite(one)) { low = Math.min(low, one); high = Math.max(high, one); } });
    if (low > high) { low = 0; high = 0; }
    var middle = 0.5 * (low + high), half = Math.max(0.5 * (high - low), 0.5 * least) * (1 + margin);
    return [middle - half, middle + half];
  }

  // All values, or 99 % of them where a few reach much further; `cut` tells which. `least`: values that are always inside.
  function robust(values, least, full) {
    var sorted = values.filter(Number.isFinite).sort(function (a, b) { return a - b; }), last = sorted.length - 1;
    if (full || last < 0) return { values: values.concat(least), far: false };
    var ends = [0.005, 0.995].map(function (share) { return sorted[Math.round(share * last)]; }).concat(least);
    var low = Math.min.apply(null, ends), high = Math.max.apply(null, ends), room = 0.5 * (high - low);
    var far = sorted[0] < low - room || sorted[last] > high + room;
    return { values: far ? ends : values.concat(least), far: far };
  }

  function Panel(root, top, height, x, y, title, id) {
    var self = { top: top, height: height, x: x };
    var inner = x.width;
    self.y = function (value) { return top + height * (1 - (value - y[0]) / (y[1] - y[0])); };
    var clip = LDC.svg("clipPath", { id: id }, [LDC.svg("rect", { x: LEFT, y: top, width: inner, height: height })]);
    self.back = LDC.svg("g", { "clip-path": "url(#" + id + ")" });
    self.lines = LDC.svg("g", { "clip-path": "url(#" + id + ")" });
    root.appendChild(LDC.svg("defs", {}, [clip]));
    root.appendChild(self.back);
    var marks = ticks(y[0], y[1], Math.max(3, Math.round(height / 36)));
    marks.forEach(function (value) {
      root.appendChild(LDC.svg("line", { "class": "grid", x1: LEFT, x2: LEFT + inner, y1: self.y(value), y2: self.y(value) }));
      root.appendChild(LDC.svg("text", { x: LEFT - 6, y: self.y(value) + 4, "text-anchor": "end" }, LDC.number(value, marks.digits)));
    });
    root.appendChild(self.lines);
    root.appendChild(LDC.svg("path", { "class": "frame", d: "M" + LEFT + " " + top + "V" + (top + height) + "H" + (LEFT + inner) }));
    root.appendChild(LDC.svg("text", { "class": "axis-title", x: LEFT - 52, y: top - 7 }, title));
    self.across = function (value, kind) {
      self.lines.appendChild(LDC.svg("line", { "class": kind, x1: LEFT, x2: LEFT + inner, y1: self.y(value), y2: self.y(value) }));
    };
    self.draw = function (times, values, style, width, stairs) {
      var d = "", last = 0;
      times.forEach(function (t, i) {
        if (stairs && i) d += "H" + x(t).toFixed(1);
        d += (i ? "L" : "M") + x(t).toFixed(1) + " " + self.y(values[i]).toFixed(1);
        last = i;
      });
      if (!d) return;
      self.lines.appendChild(LDC.svg("path", {
        d: d, fill: "none", stroke: style.color, "stroke-width": width,
        "stroke-dasharray": style.dash.map(function (one) { return one * width; }).join(" ") || null, "data-samples": last + 1
      }));
    };
    return self;
  }

  // Draw into a holder. `shown`: {T, far, zoom, full, recorded: {line, style}, designs: [{line, style}]}; `pick(t)` is called
  // with the time under the pointer. The answer moves the cursor.
  LDC.departurePlot = function (holder, shown, title, pick) {
    var full = Math.max(280, holder.clientWidth || 640), inner = full - LEFT - RIGHT;
    var heights = [full < 500 ? 220 : 280, 110, 130], gap = 34, top = 26;
    var paths = shown.designs.filter(function (one) { return one.line; });
    var end = Math.max.apply(null, [shown.T].concat(paths.map(function (one) { return one.line.t[one.line.t.length - 1]; })));
    function x(t) { return LEFT + inner * t / end; }
    x.width = inner;
    function all(name) { return [].concat.apply([], paths.map(function (one) { return one.line[name]; })); }

    var high = Math.max(2 * shown.recorded.line.deepest, 0.5);
    var y = all("y").concat(shown.recorded.line.y, [0], shown.zoom ? [] : [shown.far]).map(function (one) {
      return Math.min(Math.max(one, Math.min(1.4 * shown.far, -2.4)), high);
    });
    var height = top + heights[0] + heights[1] + heights[2] + 2 * gap + 40;
    var root = LDC.svg("svg", { viewBox: "0 0 " + full + " " + height, width: full, height: height, role: "img", "aria-label": title });
    var delta = robust(all("delta"), [0], shown.full);
    var a = robust(all("a_y").concat(shown.recorded.line.a_y), [-1.2 * LIMIT, 1.2 * LIMIT], shown.full);
    var first = Panel(root, top, heights[0], x, range(y, 0.1, 0.08), "Edge beyond the line y [m]", "explorer-clip-y");
    var second = Panel(root, top + heights[0] + gap, heights[1], x, range(delta.values, 0.2, 0.1), "Steering angle δ [°]", "explorer-clip-delta");
    var third = Panel(root, top + heights[0] + heights[1] + 2 * gap, heights[2], x, range(a.values, 1, 0.08), "Lateral acceleration [m/s²]", "explorer-clip-a");
    var panels = [first, second, third];

    first.back.appendChild(LDC.svg("rect", { "class": "lane", x: LEFT, width: inner, y: first.y(0), height: Math.max(0, first.y(shown.far) - first.y(0)) }));
    first.across(0, "line");
    first.across(shown.far, "line");
    second.across(0, "frame");
    third.across(0, "frame");
    [-LIMIT, LIMIT].forEach(function (value) { third.across(value, "limit"); });
    root.appendChild(LDC.svg("text", { "class": "limit-text", x: LEFT + inner, y: third.y(LIMIT) - 4, "text-anchor": "end" }, "±3 m/s²"));
    panels.forEach(function (panel) {
      panel.back.appendChild(LDC.svg("line", { "class": "end", x1: x(shown.T), x2: x(shown.T), y1: panel.top, y2: panel.top + panel.height }));
    });
    var atEnd = x(shown.T) > LEFT + 0.6 * inner;
    root.appendChild(LDC.svg("text", { x: x(shown.T) + (atEnd ? -5 : 5), y: (shown.zoom ? top + heights[0] : first.y(shown.far)) - 8, "text-anchor": atEnd ? "end" : "start" }, "end of the departure"));
    ticks(0, end, Math.max(3, Math.round(inner / 90))).forEach(function (t, i, list) {
      root.appendChild(LDC.svg("text", { x: x(t), y: height - 22, "text-anchor": "middle" }, LDC.number(t, list.digits)));
    });
    root.appendChild(LDC.svg("text", { "class": "axis-title", x: LEFT + 0.5 * inner, y: height - 5, "text-anchor": "middle" }, "Time since the crossing t [s]"));

    var recorded = shown.recorded;
    first.draw(recorded.line.t, recorded.line.y, recorded.style, 2);
    third.draw(recorded.line.t, recorded.line.a_y, recorded.style, 1.6);
    paths.slice().reverse().forEach(function (one) {
      first.draw(one.line.t, one.line.y, one.style, 2.2);
      second.draw(one.line.t, one.line.delta, one.style, 1.8, true);
      third.draw(one.line.t, one.line.a_y, one.style, 1.6);
    });
    // Triggers that fall on each other share one badge.
    var badges = [];
    shown.designs.forEach(function (one, i) {
      if (!one.line) return;
      var at = [x(one.line.t[0]), first.y(one.line.y[0])];
      var near = badges.find(function (badge) { return Math.abs(badge.at[0] - at[0]) < 18 && Math.abs(badge.at[1] - at[1]) < 18; });
      if (near) near.numbers.push(i + 1);
      else badges.push({ at: at, numbers: [i + 1], color: one.style.color });
    });
    badges.forEach(function (badge) {
      var many = badge.numbers.length, wide = 4 + 12 * many;
      var middle = Math.max(badge.at[0], LEFT + 0.5 * wide), high = Math.max(badge.at[1], top + 8);
      root.appendChild(LDC.svg("g", { "class": "trigger" }, [
        LDC.svg("rect", { x: middle - 0.5 * wide, y: high - 8, width: wide, height: 16, rx: 8, fill: "#fff", stroke: many > 1 ? "#333" : badge.color, "stroke-width": 2 }),
        LDC.svg("text", { x: middle, y: high + 4, "text-anchor": "middle" }, badge.numbers.join(" "))
      ]));
    });

    var cursor = LDC.svg("g", {});
    root.appendChild(cursor);
    function move(event) {
      var box = root.getBoundingClientRect();
      var t = ((event.clientX - box.left) * full / box.width - LEFT) / inner * end;
      pick(Math.min(Math.max(t, 0), end));
    }
    root.addEventListener("pointermove", move);
    root.addEventListener("pointerdown", move);
    holder.textContent = "";
    holder.appendChild(root);
    return {
      end: end,
      // Whether the steering angle or the acceleration leaves its panel.
      cut: delta.far || a.far,
      // `points`: [{color, y, delta, a_y}], not a number where there is none.
      cursor: function (t, points) {
        cursor.textContent = "";
        panels.forEach(function (panel, i) {
          cursor.appendChild(LDC.svg("line", { "class": "cursor", x1: x(t), x2: x(t), y1: panel.top, y2: panel.top + panel.height }));
          points.forEach(function (point) {
            var at = panel.y(point[["y", "delta", "a_y"][i]]);
            if (at >= panel.top && at <= panel.top + panel.height) {
              cursor.appendChild(LDC.svg("circle", { cx: x(t), cy: at, r: 4, fill: point.color, stroke: "#fff" }));
            }
          });
        });
      }
    };
  };
})();
