// Sorting: the order of a column, and by a click on its head for ranking tables that hold their rows themselves.
(function () {
  "use strict";
  // Numbers or texts up or down; NaN last in both directions, equal ones as they stand.
  LDC.sorted = function (items, value, down) {
    var sign = down ? -1 : 1;
    return items.map(function (item) { return [item, value(item)]; }).sort(function (a, b) {
      var x = a[1], y = b[1];
      if (Number.isNaN(x) || Number.isNaN(y)) return Number(Number.isNaN(x)) - Number(Number.isNaN(y));
      return sign * (x < y ? -1 : x > y ? 1 : 0);
    }).map(function (one) { return one[0]; });
  };
  function sortable(table) {
    var body = table.tBodies[0], rows = Array.from(body.rows);
    function value(row, column) {
      var text = row.cells[column].dataset.v;
      return text === "" ? Number.NaN : Number(text);
    }
    table.querySelectorAll("thead th").forEach(function (head, column) {
      if (!rows.length || !rows[0].cells[column].hasAttribute("data-v")) return;
      var button = LDC.el("button", { type: "button" });
      while (head.firstChild) button.appendChild(head.firstChild);
      head.appendChild(button);
      if (column === 0) head.setAttribute("aria-sort", "ascending");
      button.addEventListener("click", function () {
        var down = head.getAttribute("aria-sort") === "ascending";
        table.querySelectorAll("th[aria-sort]").forEach(function (other) { other.removeAttribute("aria-sort"); });
        head.setAttribute("aria-sort", down ? "descending" : "ascending");
        LDC.sorted(rows, function (row) { return value(row, column); }, down).forEach(function (row) { body.appendChild(row); });
      });
    });
  }
  document.querySelectorAll("table.ranking").forEach(function (table) {
    if (!table.closest("#ranking-1")) sortable(table);
  });
})();
