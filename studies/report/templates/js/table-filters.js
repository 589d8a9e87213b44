// Filters and choice of columns above the ranking table; tells its listener when anything changes.
(function () {
  "use strict";
  var designs = LDC.designs, home = document.getElementById("ranking-filters");
  if (!designs || !home) return;
  var el = LDC.el, data = designs.data, timer = 0, listener = function () {};

  function changed() { listener(); }
  function box(title, on, act) {
    var input = el("input", { type: "checkbox", checked: on, change: act || changed });
    return { input: input, label: el("label", {}, [input, " ", el("span", {}, title)]) };
  }
  var search = el("input", {
    type: "search", id: "ranking-search", placeholder: "name, id, gain=value", autocomplete: "off", input: function () {
      clearTimeout(timer);
      timer = setTimeout(changed, designs.count > 1000 ? 150 : 0);
    }
  });
  var laws = data.laws.map(function (law, k) {
    var made = box(LDC.symbols(law.title), true);
    made.law = k;
    return made;
  });
  var TESTS = [
    ["meets requirements", data.require.length > 0, function (i) { return designs.unmet(i).length === 0; }],
    ["set of best", true, function (i) { return designs.is("set_of_best", i); }],
    ["Pareto front", data.pareto.length > 0, function (i) { return designs.is("pareto", i); }],
    ["with failures", true, function (i) { return designs.failures(i) > 0 || designs.figure("failed_solves")[i] > 0; }]
  ];
  var tests = TESTS.filter(function (one) { return one[1]; }).map(function (one) {
    var made = box(one[0], false);
    made.holds = one[2];
    return made;
  });
  var columns = LDC.table.columns.filter(function (one) { return !one.fixed; }).map(function (one) {
    var made = box(LDC.symbols(one.title), LDC.table.standard.indexOf(one.key) >= 0);
    made.column = one;
    return made;
  });
  var count = el("p", { "class": "count", "aria-live": "polite", id: "ranking-count" });
  var reset = el("button", { type: "button", click: function () { clear(); changed(); search.focus(); } }, "Reset");

  function clear() {
    search.value = "";
    laws.forEach(function (one) { one.input.checked = true; });
    tests.forEach(function (one) { one.input.checked = false; });
    columns.forEach(function (one) { one.input.checked = LDC.table.standard.indexOf(one.column.key) >= 0; });
    LDC.filters.onreset();
  }
  function every(boxes, on) {
    return el("button", { type: "button", click: function () {
      boxes.forEach(function (one) { one.input.checked = on; });
      changed();
    } }, on ? "All" : "None");
  }
  function group(title, boxes) {
    return el("fieldset", {}, [el("legend", {}, title)].concat(boxes.map(function (one) { return one.label; })));
  }
  function folded(title, boxes, inside) {
    var said = el("summary", {}, title);
    return { said: said, node: el("details", {}, [said, el("div", { "class": "choices" }, inside)]), boxes: boxes, title: title };
  }
  var byGroup = [];
  columns.forEach(function (one) {
    var last = byGroup.filter(function (found) { return found.title === one.column.group; })[0];
    if (!last) byGroup.push(last = { title: one.column.group, boxes: [] });
    last.boxes.push(one);
  });
  var foldedLaws = folded("Laws", laws, [el("div", { "class": "both" }, [every(laws, true), every(laws, false)]), group("Show designs of", laws)]);
  var foldedColumns = folded("Columns", columns, [el("div", { "class": "both" }, [every(columns, true), every(columns, false)])]
    .concat(byGroup.map(function (one) { return group(one.title, one.boxes); })));
  home.appendChild(el("div", { "class": "controls", role: "group", "aria-label": "Filters of the ranking" }, [
    el("label", { "for": "ranking-search" }, ["Search ", search])
  ].concat(tests.map(function (one) { return one.label; }), [foldedLaws.node, foldedColumns.node, reset])));
  home.appendChild(count);

  function told(one) {
    var on = one.boxes.filter(function (made) { return made.input.checked; }).length;
    one.said.textContent = one.title + " (" + on + " of " + one.boxes.length + ")";
  }
  LDC.filters = {
    onchange: function (act) { listener = act; },
    onreset: function () {},
    // Places of the designs that pass, in the order of the ranking.
    passing: function () {
      var wanted = LDC.search(search.value);
      var asked = tests.filter(function (one) { return one.input.checked; }), found = [];
      var allowed = laws.map(function (one) { return one.input.checked; });
      for (var i = 0; i < designs.count; i++) {
        if (allowed[designs.law(i)] && asked.every(function (one) { return one.holds(i); }) && wanted(i)) found.push(i);
      }
      return found;
    },
    columns: function () {
      var hidden = columns.filter(function (one) { return !one.input.checked; }).map(function (one) { return one.column; });
      return LDC.table.columns.filter(function (one) { return hidden.indexOf(one) < 0; });
    },
    tell: function (text) {
      if (count.textContent !== text) count.textContent = text;
      told(foldedLaws);
      told(foldedColumns);
    }
  };
})();
