// The ranking table of the primary case: all designs, page by page, sorted by any column.
(function () {
  "use strict";
  var designs = LDC.designs, region = document.getElementById("ranking-1"), home = document.getElementById("ranking-pages");
  if (!designs || !region || !home) return;
  var el = LDC.el, table = region.querySelector("table"), head = table.tHead, body = table.tBodies[0];
  var sort = { key: "rank", down: false }, page = 0, size = 50, order = [], last = 0;

  function heading(column) {
    var kind = column.kind || (column.text ? "" : "n"), title = LDC.symbols(column.title);
    if (!column.value) return el("th", { scope: "col", "class": kind }, title);
    var on = column.key === sort.key;
    return el("th", { scope: "col", "class": kind, "aria-sort": on ? (sort.down ? "descending" : "ascending") : null }, [
      el("button", { type: "button", "data-key": column.key, click: function () {
        sort = { key: column.key, down: column.key === sort.key && !sort.down };
        page = 0;
        update();
        head.querySelector("button[data-key=\"" + column.key + "\"]").focus();
      } }, title)
    ]);
  }
  function row(i, columns) {
    var wins = designs.is("winner", i);
    var kind = wins ? "best" : designs.is("set_of_best", i) ? "tied" : null;
    return el("tr", { "class": kind }, columns.map(function (column) { return column.cell(i); }));
  }
  function replace(node, children) {
    while (node.firstChild) node.removeChild(node.firstChild);
    children.forEach(function (child) { node.appendChild(child); });
  }

  var before = el("button", { type: "button", click: function () { turn(-1); } }, "Previous");
  var after = el("button", { type: "button", click: function () { turn(1); } }, "Next");
  var where = el("span", { "class": "where" });
  var sizes = el("select", { change: function () { size = Number(sizes.value) || Infinity; page = 0; draw(); } },
    [["25", 25], ["50", 50], ["100", 100], ["250", 250], ["all", 0]].map(function (one) {
      return el("option", { value: one[1], selected: one[1] === size }, one[0]);
    }));
  var pages = el("div", { "class": "controls pages", role: "group", "aria-label": "Pages of the ranking" },
    [before, where, after, el("label", {}, ["Rows ", sizes])]);
  home.appendChild(pages);

  function turn(by) {
    page += by;
    draw();
    region.scrollTop = 0;
  }
  function draw() {
    var columns = LDC.filters.columns(), first = page * size || 0;
    last = Math.min(order.length, first + size);
    replace(head.rows[0], columns.map(heading));
    replace(body, order.slice(first, last).map(function (i) { return row(i, columns); }));
    if (!order.length) {
      body.appendChild(el("tr", {}, [el("td", { colspan: columns.length }, "No design passes these filters.")]));
    }
    pages.hidden = order.length <= 25;
    before.disabled = page === 0;
    after.disabled = last >= order.length;
    where.textContent = order.length ? "rows " + (first + 1).toLocaleString("en") + " to " + last.toLocaleString("en") : "no rows";
    LDC.filters.tell("Showing " + order.length.toLocaleString("en") + " of " + designs.count.toLocaleString("en") + (designs.count === 1 ? " design" : " designs"));
  }
  function update() {
    var columns = LDC.filters.columns(), by = columns.filter(function (one) { return one.key === sort.key; })[0];
    if (!by) sort = { key: "rank", down: false };
    order = LDC.filters.passing();
    if (sort.key !== "rank" || sort.down) order = LDC.sorted(order, (by || LDC.table.columns[0]).value, sort.down);
    if (page * size >= order.length) page = 0;
    draw();
  }
  // On paper a page of the table is a hundred designs at least.
  var kept = null;
  window.addEventListener("beforeprint", function () {
    if (kept === null) kept = [page, size];
    page = 0;
    size = Math.max(size, 100);
    draw();
  });
  window.addEventListener("afterprint", function () {
    if (kept === null) return;
    page = kept[0];
    size = kept[1];
    kept = null;
    draw();
  });
  LDC.filters.onchange(function () { page = 0; update(); });
  LDC.filters.onreset = function () { sort = { key: "rank", down: false }; page = 0; };
  update();
})();
