// The columns that the ranking table can have: title, value to sort by, and cell.
(function () {
  "use strict";
  var designs = LDC.designs;
  if (!designs) return;
  var data = designs.data, el = LDC.el;

  function br() { return el("br"); }
  function small(text) { return el("small", {}, text); }
  function bracket(of, i, digits, scale) {
    var s = scale || 1;
    return "[" + LDC.number(s * of.low[i], digits) + " to " + LDC.number(s * of.high[i], digits) + "]";
  }
  function change(value) { return LDC.signed(-100 * value, 1) + "\u00a0%"; }
  function bar(i) {
    var S = designs.interval("S"), full = data.full * data.uncorrected;
    function share(value) { return (full > 0 ? 100 * Math.min(Math.max(value / full, 0), 1) : 0).toFixed(1) + "%"; }
    var mark = el("i", { "class": S.value[i] > full ? "bar over" : "bar" });
    mark.style.setProperty("--w", share(S.value[i]));
    mark.style.setProperty("--l", share(S.low[i]));
    mark.style.setProperty("--h", share(S.high[i]));
    return mark;
  }
  // Tags of a design, as nodes with spaces between them.
  function tags(i) {
    return designs.tags(i).reduce(function (found, text) {
      return found.concat(document.createTextNode(" "), el("span", { "class": text === "winner" ? "tag strong" : "tag" }, text));
    }, []);
  }
  function missed(i) {
    return [[designs.unmet(i), ""], [designs.freshUnmet(i), " on the fresh departures"]].filter(function (one) { return one[0].length; })
      .map(function (one) { return el("small", { "class": "missed" }, ["misses ", LDC.symbols(one[0].join(", ")), one[1]]); });
  }
  function gains(i) {
    var found = designs.named(i).map(function (gain) {
      var parts = [LDC.symbols(gain.name), "\u00a0=\u00a0" + gain.text];
      if (gain.unit) parts.push("\u00a0", small(gain.unit));
      return el("span", {}, parts);
    });
    if (!found.length) return [el("span", {}, designs.is("passive", i) ? "–" : "defaults")];
    return found.reduce(function (all, one) { return all.concat(all.length ? [" ", one] : [one]); }, []);
  }
  function name(i) {
    var one = designs.place(i), cell = el("th", { scope: "row" });
    cell.appendChild(el("button", {
      type: "button", "class": "open", title: one.label, "aria-haspopup": "dialog", "data-place": i,
      click: function () { designs.choose(i); }
    }, LDC.symbols(one.title)));
    tags(i).forEach(function (node) { cell.appendChild(node); });
    cell.appendChild(br());
    cell.appendChild(el("code", {}, one.law));
    var notes = missed(i);
    if (!designs.unmet(i).length && data.require.length) notes.unshift(small("meets all requirements"));
    notes.forEach(function (note) { cell.appendChild(br()); cell.appendChild(note); });
    return cell;
  }
  function cell(children, kind) { return el("td", { "class": kind || "n" }, children); }
  function withEnds(key, title, show, skip) {
    var of = designs.interval(key);
    if (!of) return null;
    return {
      key: key, title: title, group: "Compared", value: function (i) { return of.value[i]; }, cell: function (i) {
        if (skip(i) || Number.isNaN(of.value[i])) return cell("–");
        return cell([show(of.value[i]), br(), small(bracket(of, i))]);
      }
    };
  }
  function paired(key, title, skip) { return withEnds(key, title, LDC.signed, skip || never); }
  function ofSide(key, title) {
    var S = designs.figure("S_" + key), less = designs.figure("reduction_" + key);
    return {
      key: "S_" + key, title: title, group: "Score", value: function (i) { return S[i]; }, cell: function (i) {
        return cell(Number.isNaN(S[i]) ? "–" : [LDC.number(S[i]), br(), small(change(less[i]))]);
      }
    };
  }
  function never() { return false; }
  function ranked(i) { return designs.rank(i) || Number.NaN; }

  var S = designs.interval("S"), less = designs.interval("reduction");
  var columns = [
    { key: "rank", title: "Rank", fixed: true, value: ranked, cell: function (i) { return cell(designs.rank(i) || "–"); } },
    { key: "design", title: "Design", fixed: true, text: true, value: function (i) { return designs.place(i).title; }, cell: name },
    { key: "y_s", title: "y_s [m]", group: "Design", value: function (i) { return designs.is("passive", i) ? Number.NaN : Number(designs.place(i).y_s_toml); },
      cell: function (i) { return cell(designs.is("passive", i) ? "–" : designs.place(i).y_s); } },
    { key: "gains", title: "Gains", group: "Design", kind: "gains", text: true, cell: function (i) { return cell(gains(i), "gains"); } },
    { key: "S", title: "Mean S [m·s]", group: "Score", kind: "S", value: function (i) { return S.value[i]; },
      cell: function (i) { return cell([el("b", {}, LDC.number(S.value[i])), " ", small(bracket(S, i)), bar(i)], "S"); } },
    { key: "reduction", title: "Against no control", group: "Score", value: function (i) { return -less.value[i]; },
      cell: function (i) { return cell(change(less.value[i])); } },
    ofSide("left", "Left S"),
    ofSide("right", "Right S"),
    paired("difference", "Difference to " + (designs.rank(0) ? "best" : "lowest") + " [m·s]", function (i) { return i === 0; }),
    paired("baseline_difference", "Difference to baseline [m·s]", function (i) { return designs.is("baseline", i); }),
    withEnds("fresh_S", "Fresh S [m·s]", LDC.number, never),
    paired("fresh_difference", "Fresh difference to first [m·s]"),
    paired("fresh_baseline_difference", "Fresh difference to baseline [m·s]"),
    paired("optimism", "Optimism [m·s]")
  ].filter(function (one) { return one !== null; });
  function ofFigure(figure) {
    var values = designs.figure(figure.name);
    return {
      key: figure.name, title: designs.titled(figure), group: data.groups[figure.group], value: function (i) { return values[i]; },
      cell: function (i) {
        var parts = [designs.shown(figure.name, i)];
        (data.limits[figure.name] || []).forEach(function (limit) { parts.push(br(), small(limit)); });
        return cell(parts);
      }
    };
  }
  var FIRST = ["triggered", "deeper"], failures = {
    key: "failures", title: "Failures", group: data.groups.failures, value: designs.failures,
    cell: function (i) { var many = designs.failures(i); return cell(many.toLocaleString("en"), many ? "n bad" : "n"); }
  };
  Object.keys(data.limits).forEach(function (name) {
    if (FIRST.indexOf(name) < 0 && !columns.some(function (one) { return one.key === name; })) FIRST.push(name);
  });
  columns = columns.concat(FIRST.map(function (name) { return ofFigure(designs.described(name)); }), [failures]);
  var there = columns.map(function (one) { return one.key; });
  columns = columns.concat(designs.figures.filter(function (one) { return there.indexOf(one.name) < 0; }).map(ofFigure));

  var STANDARD = ["rank", "design", "y_s", "gains", "S", "reduction", "S_left", "S_right", "difference",
    "baseline_difference", "fresh_S", "triggered", "deeper", "failures"].concat(Object.keys(data.limits));
  LDC.table = { columns: columns, standard: STANDARD, tags: tags, gains: gains, missed: missed };
})();
