for (const table of document.querySelectorAll("table[data-sortable]")) {
  const body = table.tBodies[0], rows = [...body.rows], heads = [...table.tHead.rows[0].cells];
  rows.forEach((row, i) => { row.position = i; });
  const value = (row, j) => {
    const v = row.cells[j].dataset.v;
    return v === undefined ? NaN : Number(v);
  };
  heads.forEach((head, j) => {
    const button = LDC.element("button", {type: "button"});
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      const down = head.getAttribute("aria-sort") === "ascending";
      const numeric = rows.some((row) => !isNaN(value(row, j)));
      heads.forEach((head) => head.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", down ? "descending" : "ascending");
      const sign = down ? -1 : 1;
      const order = [...rows].sort((a, b) => {
        if (!numeric) return sign * a.cells[j].textContent.localeCompare(b.cells[j].textContent) || a.position - b.position;
        const p = value(a, j), q = value(b, j);
        if (isNaN(p) || isNaN(q)) return isNaN(p) - isNaN(q) || a.position - b.position; // without a number: last
        return sign * (p - q) || a.position - b.position;
      });
      body.append(...order);
      show();
    });
  });
  const tools = document.querySelector(`[data-table="${table.id}"]`);
  const find = tools && tools.querySelector("input"), hint = tools && tools.querySelector(".hint");
  const more = tools && tools.querySelector("button");
  const hidden = rows.findIndex((row) => row.classList.contains("later")), first = hidden < 0 ? rows.length : hidden;
  const keys = heads.map((head) => (head.dataset.key || "").toLowerCase());
  const compare = {"<": (a, b) => a < b, "<=": (a, b) => a <= b, ">": (a, b) => a > b, ">=": (a, b) => a >= b, "=": (a, b) => a === b};
  function matches(row, part) {
    const found = part.match(/^([^<>=]+)(<=|>=|<|>|=)(-?[\d.]+(?:e[-+]?\d+)?)$/i);
    const j = found ? keys.indexOf(found[1].toLowerCase()) : -1;
    if (j >= 0) return compare[found[2]](value(row, j), Number(found[3]));
    return row.textContent.toLowerCase().includes(part.toLowerCase());
  }
  function show() {
    const query = find ? find.value.replace(/\s*(<=|>=|<|>|=)\s*/g, "$1").trim() : "";
    const parts = query.split(/\s+/).filter(Boolean);
    let kept = 0, unknown = "";
    for (const row of rows) {
      const inside = parts.every((part) => matches(row, part));
      row.classList.toggle("out", !inside);
      kept += inside;
    }
    for (const part of parts) {
      const name = part.split(/[<>=]/)[0].toLowerCase();
      if (/[<>=]/.test(part) && !keys.includes(name)) unknown = name;
    }
    // without a search: the first rows of the order shown, until all are requested
    const all = table.classList.contains("all") || parts.length > 0;
    [...body.rows].forEach((row, i) => row.classList.toggle("later", !all && i >= first && !row.classList.contains("kept")));
    if (parts.length) [...body.rows].forEach((row) => row.classList.remove("later"));
    if (hint) {
      hint.textContent = unknown ? `no column ${unknown}: compare ${keys.filter(Boolean).join(", ")}, as in S<0.6`
        : parts.length ? `${kept} of ${rows.length} rows` : "";
    }
  }
  if (find) find.addEventListener("input", show);
  if (more) more.addEventListener("click", () => {
    const all = table.classList.toggle("all");
    more.setAttribute("aria-pressed", String(all));
    show();
  });
}
