{
  const E = LDC.data.departures, p = E.departures.length, c = E.designs.length;
  const count = LDC.numbers(E.count), start = LDC.numbers(E.start), duration = LDC.numbers(E.duration);
  const paths = {}, recorded = {}, first = new Int32Array(c * p + 1), firstRecorded = new Int32Array(p + 1);
  for (const name of Object.keys(E.paths)) paths[name] = LDC.numbers(E.paths[name]);
  for (const name of ["y", "a_y"]) recorded[name] = LDC.numbers(E.recorded[name]);
  const recordedCount = LDC.numbers(E.recorded.count);
  for (let i = 0; i < c * p; i++) first[i + 1] = first[i] + count[i];
  for (let k = 0; k < p; k++) firstRecorded[k + 1] = firstRecorded[k] + recordedCount[k];
  const shown = E.designs.map((_, i) => i < 3);
  const select = document.getElementById("departure"), area = document.getElementById("paths");
  const body = document.querySelector("#departure-table tbody");
  E.departures.forEach((departure, k) => select.append(LDC.element("option", {value: k}, departure.name)));
  // what each design planned: numbers of `departures` by sample, of which the first is when the plan begins
  const plans = E.plans.map((plan) => ({...plan, values: LDC.numbers(plan.values)}));
  const slider = document.getElementById("plan"), planTime = document.getElementById("plan-time");
  const W = 420, H = 220, L = 52, R = 10, T = 8, B = 42;

  function curves(name, k) {
    const found = [];
    if (recorded[name]) {
      const t = [], v = [];
      for (let j = 0; j < recordedCount[k]; j++) {
        t.push(Math.min(j * E.step, duration[k]));
        v.push(recorded[name][firstRecorded[k] + j] * E.resolution[name]);
      }
      found.push({t, v, style: "recorded", dash: "2 2.5", name: "recorded"});
    }
    for (let i = 0; i < c; i++) {
      const at = i * p + k, t = [], v = [];
      if (!shown[i]) continue;
      for (let j = 0; j < count[at]; j++) {
        t.push(start[at] + j * E.step);
        v.push(paths[name][first[at] + j] * E.resolution[name]);
      }
      if (t.length) found.push({t, v, ...E.designs[i]});
    }
    return found;
  }
  function planned(k) {
    const found = [];
    plans.forEach((plan, i) => {
      const place = plan.departures.indexOf(k), [samples, width] = plan.shape, j = Number(slider.value);
      if (!shown[i] || place < 0 || j >= samples) return;
      const row = plan.values.subarray((place * samples + j) * width, (place * samples + j + 1) * width);
      if (Number.isNaN(row[0]) || Number.isNaN(row[1])) return;
      const v = Array.from(row.subarray(1)), begin = start[i * p + k] + j * E.plan_step + row[0];
      found.push({t: v.map((_, n) => begin + n * E.dt), v, style: `${E.designs[i].style} planned`, name: `${E.designs[i].name}, planned`});
    });
    return found;
  }
  // the first scale that holds everything drawn
  const scale = (scales, low, high) => scales.find((candidate) => candidate.low <= low && high <= candidate.high) || scales[scales.length - 1];

  function panel(name, title, k, end) {
    const drawn = name === "y" ? [...curves(name, k), ...planned(k)] : curves(name, k), all = drawn.flatMap((curve) => curve.v);
    const x = scale(E.scales.t, 0, end);
    const y = scale(E.scales[name], Math.min(0, ...all), Math.max(0, ...all));
    const px = (t) => L + (W - L - R) * (t - x.low) / (x.high - x.low);
    const py = (v) => T + (H - T - B) * (1 - (v - y.low) / (y.high - y.low));
    const svg = LDC.element("svg", {class: "chart", role: "img", viewBox: `0 0 ${W} ${H}`, "aria-label": `${title} over time`});
    let grid = "";
    for (const [value, text] of x.ticks) {
      grid += `M${px(value)} ${T}V${H - B}`;
      svg.append(LDC.element("text", {x: px(value), y: H - B + 15, "text-anchor": "middle"}, text));
    }
    for (const [value, text] of y.ticks) {
      grid += `M${L} ${py(value)}H${W - R}`;
      svg.append(LDC.element("text", {x: L - 5, y: py(value) + 4, "text-anchor": "end"}, text));
    }
    svg.prepend(LDC.element("path", {class: "grid", d: grid}));
    svg.append(LDC.element("path", {class: "axis", d: `M${L} ${py(0)}H${W - R}M${L} ${T}V${H - B}`}));
    svg.append(LDC.element("path", {class: "grid", "stroke-dasharray": "3 3", d: `M${px(duration[k])} ${T}V${H - B}`}));
    svg.append(LDC.element("text", {class: "soft", x: (L + W - R) / 2, y: H - 6, "text-anchor": "middle"}, "Time since the crossing [s]"));
    svg.append(LDC.element("text", {class: "soft", transform: `translate(12 ${(T + H - B) / 2}) rotate(-90)`, "text-anchor": "middle"}, title));
    for (const curve of drawn) {
      const d = curve.t.map((t, j) => `${j ? "L" : "M"}${px(t).toFixed(1)} ${py(curve.v[j]).toFixed(1)}`).join("");
      const path = LDC.element("path", {class: `curve ${curve.style}`, d, "stroke-dasharray": curve.dash || "none"});
      path.append(LDC.element("title", {}, curve.name));
      svg.append(path);
    }
    const box = LDC.element("div", {class: "panel"});
    box.append(svg);
    return box;
  }

  function draw() {
    const k = Number(select.value);
    document.getElementById("departure-facts").textContent = E.departures[k].facts;
    const last = Math.max(-1, ...plans.map((plan, i) => {
      const place = shown[i] ? plan.departures.indexOf(k) : -1, [samples, width] = plan.shape;
      let j = place < 0 ? -1 : samples - 1;
      while (j >= 0 && Number.isNaN(plan.values[(place * samples + j) * width])) j--;
      return j;
    }));
    document.getElementById("plan-tools").hidden = last < 0;
    slider.max = Math.max(last, 0);
    planTime.textContent = `${(Number(slider.value) * E.plan_step).toFixed(2)} s after the trigger`;
    let end = duration[k];
    for (let i = 0; i < c; i++) if (shown[i] && count[i * p + k]) end = Math.max(end, start[i * p + k] + (count[i * p + k] - 1) * E.step);
    area.replaceChildren(panel("y", "Edge beyond the line [m]", k, end), panel("a_y", "Lateral acceleration [m/s²]", k, end),
      panel("delta", "Steering angle [°]", k, end));
    body.replaceChildren(...E.designs.map((design, i) => {
      const row = LDC.element("tr"), head = LDC.element("th", {scope: "row"}), label = LDC.element("label");
      const box = LDC.element("input", {type: "checkbox"});
      box.checked = shown[i];
      box.addEventListener("change", () => { shown[i] = box.checked; draw(); body.rows[i].querySelector("input").focus(); });
      const key = LDC.element("svg", {width: 26, height: 12, class: "key", "aria-hidden": "true"});
      key.append(LDC.element("path", {class: `curve ${design.style}`, d: "M0 6H26", "stroke-dasharray": design.dash || "none"}));
      label.append(box, key, `${design.name} (${design.why})`);
      head.append(label);
      row.append(head);
      E.facts[i][k].forEach((text, j) => row.append(LDC.element("td", j < 4 ? {class: "n"} : {}, text)));
      return row;
    }));
  }
  const move = (by) => { select.value = (Number(select.value) + by + p) % p; draw(); };
  document.getElementById("previous").addEventListener("click", () => move(-1));
  document.getElementById("next").addEventListener("click", () => move(1));
  select.addEventListener("change", draw);
  slider.addEventListener("input", draw);
  select.value = E.open;
  draw();
}
