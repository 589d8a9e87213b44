// Axes of a scatter: robust ranges, scales, ticks, and the front of two figures.
(function () {
  "use strict";
  function quantile(sorted, q) {
    var at = q * (sorted.length - 1), low = Math.floor(at), high = Math.ceil(at);
    return sorted[low] + (at - low) * (sorted[high] - sorted[low]);
  }
  // Ends that hold nearly all values and those to keep: [low, high] with a margin.
  function range(values, kept, everything, log) {
    var of = values.map(log ? Math.log10 : Number).sort(function (a, b) { return a - b; });
    var low = of[0], high = of[of.length - 1];
    if (!everything && of.length > 4) {
      var first = quantile(of, 0.1), last = quantile(of, 0.9), reach = 1.5 * (last - first);
      var inside = of.filter(function (value) { return value >= first - reach && value <= last + reach; });
      low = inside[0];
      high = inside[inside.length - 1];
      kept.map(log ? Math.log10 : Number).forEach(function (value) {
        low = Math.min(low, value);
        high = Math.max(high, value);
      });
    }
    var margin = 0.04 * (high - low) || (log ? 0.1 : 0.05 * Math.abs(high) || 0.5);
    return [low - margin, high + margin];
  }
  function trimmed(value, digits) { return LDC.number(value, Math.max(0, Math.min(digits, 8))); }
  // Ticks as {at, text}; `at` in the numbers of `range`.
  function ticks(ends, log, most) {
    var span = ends[1] - ends[0], found = [], unit, step, k;
    if (!Number.isFinite(span)) return found;
    if (log && span > 0.9) {
      var some = span > 3 ? [1] : span > 1.6 ? [1, 3] : [1, 2, 5];
      for (k = Math.floor(ends[0]); k <= ends[1]; k++) {
        for (var j = 0; j < some.length; j++) {
          var at = k + Math.log10(some[j]);
          if (at >= ends[0] && at <= ends[1]) found.push({ at: at, text: LDC.designs.compact(some[j] * Math.pow(10, k)) });
        }
      }
      return found;
    }
    var low = log ? Math.pow(10, ends[0]) : ends[0], high = log ? Math.pow(10, ends[1]) : ends[1];
    unit = Math.pow(10, Math.floor(Math.log10((high - low) / most)));
    step = [1, 2, 5, 10].map(function (times) { return times * unit; }).filter(function (one) { return (high - low) / one <= most; })[0];
    for (k = Math.ceil(low / step); k * step <= high; k++) {
      var value = k * step;
      if (!log || value > 0) found.push({ at: log ? Math.log10(value) : value, text: trimmed(value, -Math.floor(Math.log10(step) + 1e-9)) });
    }
    return found;
  }
  // Places on the front of two figures, the best of the first one first; `cost` gives two numbers, smaller is better.
  function front(places, cost) {
    var of = places.map(function (i) { return { place: i, cost: cost(i) }; });
    of.sort(function (a, b) { return a.cost[0] - b.cost[0] || a.cost[1] - b.cost[1] || a.place - b.place; });
    var found = [], best = Infinity, at = Number.NaN;
    of.forEach(function (one) {
      if (one.cost[1] < best || (one.cost[1] === best && one.cost[0] === at)) {
        found.push(one.place);
        best = one.cost[1];
        at = one.cost[0];
      }
    });
    return found;
  }
  // The outline of a marker around a point.
  function marker(kind, x, y, r) {
    function lines(points) {
      return points.map(function (p, k) { return (k ? "L" : "M") + (x + p[0] * r).toFixed(1) + " " + (y + p[1] * r).toFixed(1); }).join("") + "Z";
    }
    if (kind === "s") return lines([[-0.9, -0.9], [0.9, -0.9], [0.9, 0.9], [-0.9, 0.9]]);
    if (kind === "^") return lines([[0, -1.15], [1.1, 0.9], [-1.1, 0.9]]);
    if (kind === "v") return lines([[0, 1.15], [1.1, -0.9], [-1.1, -0.9]]);
    if (kind === "D") return lines([[0, -1.25], [1.25, 0], [0, 1.25], [-1.25, 0]]);
    if (kind === "|") return lines([[-0.25, -1.5], [0.25, -1.5], [0.25, 1.5], [-0.25, 1.5]]);
    var plus = [[-0.35, -1.15], [0.35, -1.15], [0.35, -0.35], [1.15, -0.35], [1.15, 0.35], [0.35, 0.35], [0.35, 1.15],
      [-0.35, 1.15], [-0.35, 0.35], [-1.15, 0.35], [-1.15, -0.35], [-0.35, -0.35]];
    if (kind === "P") return lines(plus);
    if (kind === "X") return lines(plus.map(function (p) { return [0.75 * (p[0] - p[1]), 0.75 * (p[0] + p[1])]; }));
    return "M" + (x - r).toFixed(1) + " " + y.toFixed(1) + "a" + r + " " + r + " 0 1 0 " + 2 * r + " 0a" + r + " " + r + " 0 1 0 " + -2 * r + " 0Z";
  }
  LDC.axes = { range: range, ticks: ticks, front: front, marker: marker };
})();
