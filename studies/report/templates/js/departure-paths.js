// Paths of the departures explorer: whole numbers back into metres, degrees and m/s^2, and values at a time.
(function () {
  "use strict";

  // Where each of the paths begins in a list that holds them one after the other.
  function starts(counts) {
    var found = [], sum = 0;
    counts.forEach(function (count) { found.push(sum); sum += count; });
    return found;
  }

  // Index of the last time that is not after t, -1 before the first.
  function before(times, t) {
    var low = -1, high = times.length - 1;
    while (low < high) {
      var middle = Math.ceil((low + high) / 2);
      if (times[middle] <= t + 1e-9) low = middle; else high = middle - 1;
    }
    return low;
  }

  // Value of a line at t: straight between samples, or held; none outside.
  function at(line, name, t, held) {
    var i = before(line.t, t), last = line.t.length - 1;
    if (i < 0 || t > line.t[last] + 1e-9) return NaN;
    if (i === last || held) return line[name][i];
    var h = line.t[i + 1] - line.t[i];
    return line[name][i] + (h > 0 ? (t - line.t[i]) / h : 0) * (line[name][i + 1] - line[name][i]);
  }

  LDC.departurePaths = function (data) {
    var departures = {}, facts = {}, step = data.step;
    Object.keys(data.departures).forEach(function (name) {
      departures[name] = name === "roles" ? data.departures[name] : LDC.numbers(data.departures[name]);
    });
    Object.keys(data.facts).forEach(function (name) { facts[name] = LDC.numbers(data.facts[name]); });
    var recorded = { count: LDC.numbers(data.recorded.count), deepest: LDC.numbers(data.recorded.deepest) };
    var driven = { count: LDC.numbers(data.paths.count), start: LDC.numbers(data.paths.start) };
    ["y", "a_y"].forEach(function (name) { recorded[name] = LDC.numbers(data.recorded[name]); });
    ["y", "delta", "a_y"].forEach(function (name) { driven[name] = [].concat.apply([], data.paths[name].map(LDC.numbers)); });
    recorded.starts = starts(recorded.count);
    driven.starts = starts(driven.count);
    var p = departures.index.length;

    function line(from, k, names, time) {
      var first = from.starts[k], count = from.count[k], found = { t: [] };
      for (var i = 0; i < count; i++) found.t.push(time(i));
      names.forEach(function (name) {
        found[name] = from[name].slice(first, first + count).map(function (one) { return one * data.resolution[name]; });
      });
      return found;
    }
    return {
      count: p,
      departures: departures,
      // The path without control of departure k.
      recorded: function (k) {
        var found = line(recorded, k, ["y", "a_y"], function (i) { return Math.min(i * step, departures.T[k]); });
        found.deepest = recorded.deepest[k];
        return found;
      },
      // The path of design d on departure k, or null.
      driven: function (d, k) {
        var i = d * p + k;
        return driven.count[i] ? line(driven, i, ["y", "delta", "a_y"], function (j) { return driven.start[i] + j * step; }) : null;
      },
      // What is stored of it.
      fact: function (name, d, k) { return facts[name][d * p + k]; },
      at: at,
      // Position among the departures of the one whose number is nearest.
      nearest: function (number) {
        var best = 0;
        departures.index.forEach(function (one, k) {
          if (Math.abs(one - number) < Math.abs(departures.index[best] - number)) best = k;
        });
        return best;
      }
    };
  };
})();
