// The table of designs in both studies: sort, search, filter by verdict and law, and all rows.
(function () {
  var FIRST = 100, SMALL = 1e-3;
  var given = LDC.data("compare");
  if (!given) return;

  // Text of a difference, as the static rows have it.
  function difference(value) {
    if (value === 0) return "0";
    if (!Number.isFinite(value) || Math.abs(value) >= SMALL) return LDC.signed(value, 4);
    var shown = value.toExponential(1).replace(/e([+-])(\d)$/, "e$10$2").replace(/-/g, "\u2212");
    return value > 0 ? "+" + shown : shown;
  }
  function interval(low, high) {
    if (Number.isNaN(low) || Number.isNaN(high)) return "too few departures changed";
    if (!Number.isFinite(low) || !Number.isFinite(high)) return "too few departures";
    return difference(low) + " to " + difference(high);
  }
  function count(value) { return String(value).replace(/\B(?=(\d{3})+$)/g, ","); }

  document.querySelectorAll(".block[data-case]").forEach(function (block) {
    var table = block.querySelector("table.compared");
    if (!table) return;
    var packed = given.cases[Number(block.dataset.case)], columns = { label: packed.labels };
    Object.keys(packed).forEach(function (name) {
      if (packed[name].data !== undefined) columns[name] = LDC.numbers(packed[name]);
    });
    var laws = packed.laws, words = packed.labels.map(function (label, i) { return (label + " " + laws[columns.law[i]]).toLowerCase(); });
    var body = table.tBodies[0], more = block.querySelector(".more"), told = block.querySelector("output");
    var search = block.querySelector("[name=search]"), verdict = block.querySelector("[name=verdict]"), law = block.querySelector("[name=law]");
    var sorted = null, down = false, all = false;
    given.verdicts.forEach(function (name, i) {
      var n = columns.verdict.filter(function (one) { return one === i; }).length;
      if (n) verdict.appendChild(LDC.el("option", { value: i }, name + " (" + count(n) + ")"));
    });
    laws.forEach(function (name, i) { law.appendChild(LDC.el("option", { value: i }, name)); });

    function row(i) {
      var name = given.verdicts[columns.verdict[i]];
      var changed = columns.changed[i];
      function cell(content) { return LDC.el("td", { "class": "n" }, content); }
      return LDC.el("tr", { "class": name.split(" ")[0] }, [
        LDC.el("td", { "class": "verdict" }, [LDC.el("i", { "aria-hidden": "true" }, given.marks[columns.verdict[i]]), name]),
        LDC.el("th", { scope: "row" }, [LDC.symbols(columns.label[i]), LDC.el("br"), LDC.el("code", {}, laws[columns.law[i]])]),
        cell(LDC.number(columns.S_old[i], 4)),
        cell(LDC.number(columns.S_new[i], 4)),
        cell([difference(columns.difference[i]), LDC.el("br"), LDC.el("small", {}, "[" + interval(columns.low[i], columns.high[i]) + "]")]),
        cell(count(changed)),
        cell(changed ? difference(columns.largest[i]) + " (no. " + columns.largest_at[i] + ")" : "\u2013"),
        cell(count(columns.failed_old[i]) + ", " + count(columns.failed_new[i]))
      ]);
    }

    function chosen() {
      var wanted = search.value.toLowerCase().split(/\s+/).filter(Boolean), rows = [];
      for (var i = 0; i < words.length; i++) {
        if (verdict.value !== "" && columns.verdict[i] !== Number(verdict.value)) continue;
        if (law.value !== "" && columns.law[i] !== Number(law.value)) continue;
        if (wanted.every(function (part) { return words[i].indexOf(part) >= 0; })) rows.push(i);
      }
      if (sorted) {
        var values = columns[sorted];
        rows = LDC.sorted(rows, function (i) { return values[i]; }, down);
      }
      return rows;
    }

    function draw() {
      var rows = chosen(), shown = all ? rows : rows.slice(0, FIRST);
      while (body.firstChild) body.removeChild(body.firstChild);
      shown.forEach(function (i) { body.appendChild(row(i)); });
      told.textContent = count(rows.length) + " of " + count(words.length) + (words.length === 1 ? " design" : " designs");
      more.hidden = shown.length === rows.length;
      more.textContent = "Show all " + count(rows.length);
    }

    table.querySelectorAll("thead th[data-sort]").forEach(function (head) {
      var button = LDC.el("button", { type: "button" });
      while (head.firstChild) button.appendChild(head.firstChild);
      head.appendChild(button);
      button.addEventListener("click", function () {
        down = head.getAttribute("aria-sort") === "ascending";
        sorted = head.dataset.sort;
        table.querySelectorAll("th[aria-sort]").forEach(function (other) { other.removeAttribute("aria-sort"); });
        head.setAttribute("aria-sort", down ? "descending" : "ascending");
        draw();
      });
    });
    [search, verdict, law].forEach(function (input) { input.addEventListener("input", draw); });
    more.addEventListener("click", function () {
      all = true;
      draw();
      table.parentNode.focus();
    });
    draw();
  });
})();
