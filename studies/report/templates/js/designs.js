// All designs of the primary case, by place in the ranking: what tables, plots and details read.
(function () {
  "use strict";
  var data = LDC.data("ranking");
  if (!data) return;
  var FLAGS = { set_of_best: 1, pareto: 2, winner: 4, baseline: 8, paper: 16, passive: 32, best_of_law: 64 };
  var FAILURES = ["solver_failed", "diverged", "timed_out", "crashed"];
  var n = data.count, columns = {}, ends = {}, byName = {}, shown = [];

  // A column of all designs, from all numbers, one number for all, or a few with their places.
  function expand(column) {
    if (column.at) {
      var sparse = new Array(n).fill(Number.NaN), values = LDC.numbers(column.values);
      LDC.numbers(column.at).forEach(function (place, k) { sparse[place] = values[k]; });
      return sparse;
    }
    var all = LDC.numbers(column);
    return all.length === n ? all : new Array(n).fill(all[0]);
  }
  var law = LDC.numbers(data.law), rank = LDC.numbers(data.rank), flags = LDC.numbers(data.flags);
  var y_s = LDC.numbers(data.y_s.index), invalid = expand(data.invalid);
  var unmet = LDC.numbers(data.unmet.index), freshUnmet = LDC.numbers(data.fresh_unmet.index);
  data.figures.forEach(function (one) { byName[one.name] = one; });
  data.laws.forEach(function (one) {
    one.gains.forEach(function (gain) { gain.index = LDC.numbers(gain.index); });
  });
  // Gains stand law by law: which of its law's designs is each one.
  var within = [], seen = data.laws.map(function () { return 0; });
  law.forEach(function (k) { within.push(seen[k]++); });

  function figure(name) {
    if (!columns[name]) columns[name] = byName[name] ? expand(byName[name].values) : interval(name).value;
    return columns[name];
  }
  // {value, low, high} as columns, or undefined.
  function interval(name) {
    if (!ends[name] && data.ends[name]) {
      var of = data.ends[name];
      ends[name] = { value: of.value ? expand(of.value) : figure(name), low: expand(of.low), high: expand(of.high) };
    }
    return ends[name];
  }

  // A number as Python's %g writes it.
  function compact(value) {
    if (!Number.isFinite(value)) return LDC.number(value);
    if (value === 0) return "0";
    var parts = value.toExponential(5).split("e"), exponent = Number(parts[1]);
    if (exponent >= -4 && exponent < 6) return String(Number(value.toPrecision(6))).replace("-", "\u2212");
    var size = Math.abs(exponent), sign = exponent < 0 ? "\u2212" : "+";
    return String(Number(parts[0])).replace("-", "\u2212") + "e" + sign + (size < 10 ? "0" : "") + size;
  }
  // The text of a study file as people read it.
  function readable(text) {
    if (text.charAt(0) === "\"") return JSON.parse(text);
    if (text === "true" || text === "false") return text;
    if (/^-?\d+$/.test(text)) return text.replace("-", "\u2212");
    return compact(text === "inf" ? Infinity : text === "-inf" ? -Infinity : Number(text));
  }
  // Gains of a design: {name, unit, about, toml, text, fallback, swept, changed}.
  function gains(i) {
    return data.laws[law[i]].gains.map(function (gain) {
      var toml = gain.texts[gain.index[within[i]]];
      return {
        name: gain.name, unit: gain.unit, about: gain.about, toml: toml, text: readable(toml), swept: gain.swept,
        fallback: readable(gain["default"]), changed: toml !== gain["default"]
      };
    });
  }
  function named(i) { return gains(i).filter(function (gain) { return gain.swept || gain.changed; }); }
  function is(name, i) { return (flags[i] & FLAGS[name]) !== 0; }
  function threshold(i) { return readable(data.y_s.texts[y_s[i]]); }
  function label(i) {
    var changed = gains(i).filter(function (gain) { return gain.changed; });
    return [data.laws[law[i]].title, "y_s=" + threshold(i) + " m"].concat(changed.map(function (gain) {
      return gain.name + "=" + gain.text;
    })).join(", ").replace(/\u2212/g, "-");
  }
  function id(i) { return data.ids.slice(12 * i, 12 * i + 12); }
  function place(i) {
    if (!shown[i]) {
      shown[i] = {
        law: data.laws[law[i]].name, title: data.laws[law[i]].title, label: label(i), id: id(i), rank: rank[i],
        y_s: threshold(i), y_s_toml: data.y_s.texts[y_s[i]]
      };
    }
    return shown[i];
  }
  // Words beside a design's name.
  function tags(i) {
    var wins = is("winner", i);
    return [[is("paper", i), "Table I"], [wins, "winner"], [is("set_of_best", i) && !wins, "set of best"], [is("pareto", i), "Pareto"],
      [is("baseline", i), "baseline"]].filter(function (one) { return one[0]; }).map(function (one) { return one[1]; });
  }
  function failures(i) {
    return FAILURES.reduce(function (sum, name) { return sum + figure(name)[i]; }, invalid[i]);
  }
  // A figure with its digits, scaled to the unit that is shown.
  function shownValue(name, i) {
    var one = byName[name], value = figure(name)[i] * one.scale;
    return one.unit === "%" && !Number.isNaN(value) ? LDC.number(value, one.digits) + "\u00a0%" : LDC.number(value, one.digits);
  }
  function withUnit(one) { return one.unit && one.unit !== "%" ? one.title + " [" + one.unit + "]" : one.title; }
  function axis(one) { return one.unit ? one.title + " [" + one.unit + "]" : one.title; }
  function only(flag) {
    for (var i = 0; i < n; i++) if (is(flag, i)) return i;
    return -1;
  }

  LDC.styles = data.styles;
  LDC.designs = {
    count: n, data: data, laws: data.laws, figures: data.figures, place: place, figure: figure, interval: interval,
    is: is, gains: gains, named: named, tags: tags, failures: failures, shown: shownValue,
    law: function (i) { return law[i]; },
    rank: function (i) { return rank[i]; },
    unmet: function (i) { return data.unmet.sets[unmet[i]]; },
    freshUnmet: function (i) { return data.fresh_unmet.sets[freshUnmet[i]]; },
    described: function (name) { return byName[name]; },
    titled: withUnit, axis: axis, compact: compact,
    ranked: rank.filter(function (one) { return one > 0; }).length,
    winner: only("winner"), baseline: only("baseline"), passive: only("passive"),
    choose: function (i) { document.dispatchEvent(new CustomEvent("ldc:design", { detail: { place: i } })); }
  };
})();
