// Sorting by a click on a column's head; without this script the tables stand by rank.
document.querySelectorAll("table.ranking").forEach(function (table) {
  var body = table.tBodies[0];
  table.querySelectorAll("thead th").forEach(function (head, column) {
    if (!body.rows.length || !body.rows[0].cells[column].hasAttribute("data-v")) return;
    var button = document.createElement("button");
    button.type = "button";
    while (head.firstChild) button.appendChild(head.firstChild);
    head.appendChild(button);
    button.addEventListener("click", function () {
      var down = head.getAttribute("aria-sort") === "ascending";
      table.querySelectorAll("th[aria-sort]").forEach(function (other) { other.removeAttribute("aria-sort"); });
      head.setAttribute("aria-sort", down ? "descending" : "ascending");
      Array.from(body.rows).sort(function (a, b) {
        var difference = a.cells[column].dataset.v - b.cells[column].dataset.v;
        return down ? -difference : difference;
      }).forEach(function (row) { body.appendChild(row); });
    });
  });
});
