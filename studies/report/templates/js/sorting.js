// Sorting by a click on a column's head, for ranking tables that hold their rows themselves.
(function () {
  "use strict";
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
        var down = head.getAttribute("aria-sort") === "ascending", sign = down ? -1 : 1;
        table.querySelectorAll("th[aria-sort]").forEach(function (other) { other.removeAttribute("aria-sort"); });
        head.setAttribute("aria-sort", down ? "descending" : "ascending");
        rows.slice().sort(function (a, b) {
          var x = value(a, column), y = value(b, column);
          if (Number.isNaN(x) || Number.isNaN(y)) return Number(Number.isNaN(x)) - Number(Number.isNaN(y));
          return sign * (x - y);
        }).forEach(function (row) { body.appendChild(row); });
      });
    });
  }
  document.querySelectorAll("table.ranking").forEach(function (table) {
    if (!table.closest("#ranking-1")) sortable(table);
  });
})();
