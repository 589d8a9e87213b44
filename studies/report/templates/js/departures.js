// The departures explorer: choose a departure and up to four designs, read what they do.
(function () {
  "use strict";
  var data = LDC.data("departures"), MOST = 4;
  if (!data) return;
  var paths = LDC.departurePaths(data), about = paths.departures;
  function find(name) { return document.getElementById("explorer-" + name); }
  var role = find("role"), number = find("number"), time = find("time"), zoom = find("zoom"), full = find("full");
  var boxes = Array.from(document.querySelectorAll("#explorer input[name=explorer-design]"));
  var order = Array.from(about.index.keys()).sort(function (a, b) { return about.index[a] - about.index[b]; });
  var NOWHERE = { y: NaN, delta: NaN, a_y: Number.NaN };  // No path.
  var now = 0, chosen = [], plot = null;

  function side(k) { return about.side[k] > 0 ? "Left" : "Right"; }
  function seconds(t) { return LDC.number(t, 2) + "\u00a0s"; }
  function degrees(angle) { return angle * 180 / Math.PI; }

  function sample(style) {
    return LDC.svg("svg", { "class": "sample", viewBox: "0 0 36 10", width: 36, height: 10, "aria-hidden": "true" }, [
      LDC.svg("path", { d: "M1 5H35", fill: "none", stroke: style.color, "stroke-width": 2.5, "stroke-dasharray": style.dash.map(function (one) { return 2.5 * one; }).join(" ") || null })
    ]);
  }
  function fill(table, title, heads, rows) {
    table.textContent = "";
    table.appendChild(LDC.el("caption", {}, [LDC.el("span", {}, title)]));
    table.appendChild(LDC.el("thead", {}, [LDC.el("tr", {}, heads.map(function (head, i) {
      return LDC.el("th", { scope: "col", "class": i ? "n" : "design" }, [LDC.symbols(head)]);
    }))]));
    table.appendChild(LDC.el("tbody", {}, rows.map(function (row) {
      return LDC.el("tr", {}, row.map(function (cell, i) {
        var content = typeof cell === "object" ? [cell] : [String(cell)];
        return LDC.el(i ? "td" : "th", i ? { "class": "n" } : { scope: "row", "class": "design" }, content);
      }));
    })));
  }
  function label(i, d) {
    var parts = document.createDocumentFragment();
    parts.appendChild(document.createTextNode(i + 1 + " "));
    parts.appendChild(sample(data.designs[d]));
    parts.appendChild(document.createTextNode(" " + data.designs[d].title + " "));
    parts.appendChild(LDC.el("small", {}, [LDC.symbols("y_s = " + Number(data.designs[d].y_s.toPrecision(6)) + " m, " + data.designs[d].id)]));
    return parts;
  }
  function uncorrected() {
    var parts = document.createDocumentFragment();
    parts.appendChild(sample(data.line));
    parts.appendChild(document.createTextNode(" Without control"));
    return parts;
  }

  // Why a design has no path on the departure, or an empty text.
  function without(d, k) {
    if (paths.driven(d, k)) return "";
    if (paths.fact("tried", d, k)) return data.words[paths.fact("status", d, k)] === data.words[1] ? data.words[1] : "never intervenes";
    var failed = data.words[paths.fact("status", d, k)];
    return failed === data.words[0] ? "not driven again, it takes long to compute" : failed + ", not driven again";
  }
  function change(d, k) {
    var before = paths.fact("S_uncorrected", d, k);
    return before > 0 ? LDC.signed(100 * (paths.fact("S", d, k) / before - 1), 1) + "\u00a0%" : "–";
  }

  function tables() {
    var T = about.T[now], recorded = paths.recorded(now), unit = "\u00a0";
    fill(find("facts"), side(now) + " departure, scenario " + about.index[now], ["Parameter", "Symbol", "Value"], [
      ["Duration", "T", T, 2, "s"], ["Peak lateral departure", "d_y", about.d_y[now], 3, "m"],
      ["Lateral residual", "sigma_y", about.sigma_y[now], 3, "m"], ["Mean speed", "v_mean", about.v_mean[now], 2, "m/s"],
      ["Mean acceleration", "a_mean", about.a_mean[now], 3, "m/s²"], ["Speed residual", "sigma_v", about.sigma_v[now], 3, "m/s"],
      ["Initial curvature, outward", "c_0", 1000 * about.c_0[now], 3, "1/km"], ["Change of curvature", "dc", 1000 * about.dc[now], 3, "1/km"]
    ].map(function (row) { return [row[0], LDC.symbols(row[1]), LDC.number(row[2], row[3]) + unit + row[4]]; }));
    var rows = chosen.map(function (d, i) {
      function fact(name) { return paths.fact(name, d, now); }
      var missing = without(d, now), back = fact("t_back"), done = data.words[fact("status")];
      // Over the control window each design has a score without control of its own.
      var own = data.own_window ? [LDC.number(fact("S_uncorrected"))] : [];
      return [label(i, d), LDC.number(fact("S"))].concat(own, [change(d, now), LDC.number(fact("deepest")), LDC.number(fact("a_y_peak"), 2),
        LDC.number(fact("jerk_peak"), 2), LDC.number(degrees(fact("delta_peak")), 2), Number.isFinite(back) ? LDC.number(back, 2) : "not back",
        missing && missing !== done ? done + "; path: " + missing : done]);
    });
    var S_0 = data.own_window ? ["–", ""] : [LDC.number(chosen.length ? paths.fact("S_uncorrected", chosen[0], now) : NaN)];
    rows.unshift([uncorrected()].concat(S_0, ["", LDC.number(recorded.deepest), LDC.number(Math.max.apply(null, recorded.a_y.map(Math.abs)), 2), "", "", LDC.number(T, 2), ""]));
    fill(find("designs"), "Designs on this departure, as stored",
      ["Design", "S [m·s]"].concat(data.own_window ? ["S without control from the same trigger on [m·s]"] : [], ["Against no control", "Deepest [m]", "Largest |a_y| [m/s²]", "Largest jerk [m/s³]", "Largest |δ| [°]", "Back inside [s]", "What became of it"]), rows);
  }

  // Position, steering angle and acceleration at a time; before the trigger the vehicle is on the path without control.
  function point(line, recorded, t) {
    if (!line || t < line.t[0]) return { y: paths.at(recorded, "y", t), delta: NaN, a_y: paths.at(recorded, "a_y", t) };
    return { y: paths.at(line, "y", t), delta: paths.at(line, "delta", t, true), a_y: paths.at(line, "a_y", t) };
  }
  function clock() {
    var t = Number(time.value), recorded = paths.recorded(now), alone = point(null, recorded, t), spoken = [];
    var points = [{ color: data.line.color, y: alone.y, delta: NaN, a_y: alone.a_y }];
    var rows = [[uncorrected(), LDC.number(alone.y), "–", LDC.number(alone.a_y, 2)]];
    chosen.forEach(function (d, i) {
      // Who never takes over leaves the vehicle on the path without control.
      var line = paths.driven(d, now), here = line || paths.fact("tried", d, now) ? point(line, recorded, t) : NOWHERE;
      points.push({ color: data.designs[d].color, y: here.y, delta: here.delta, a_y: here.a_y });
      rows.push([label(i, d), LDC.number(here.y), LDC.number(here.delta, 2), LDC.number(here.a_y, 2)]);
      spoken.push(data.designs[d].title + " " + LDC.number(here.y, 2) + " m");
    });
    find("clock").textContent = seconds(t);
    time.setAttribute("aria-valuetext", seconds(t) + ": without control " + LDC.number(alone.y, 2) + " m; " + spoken.join("; "));
    fill(find("values"), "At t = " + LDC.number(t, 2) + " s", ["Path", "y [m]", "δ [°]", "a_y [m/s²]"], rows);
    plot.cursor(t, points);
  }

  function draw() {
    var recorded = paths.recorded(now);
    plot = LDC.departurePlot(find("plot"), {
      T: about.T[now], far: data.far, zoom: zoom.checked, full: full.checked, recorded: { line: recorded, style: data.line },
      designs: chosen.map(function (d) { return { line: paths.driven(d, now), style: data.designs[d] }; })
    }, side(now) + " departure, scenario " + about.index[now] + ": position, steering angle and lateral acceleration over time; the tables below hold the values", function (t) {
      time.value = t;
      clock();
    });
    full.parentNode.hidden = !plot.cut && !full.checked;
    find("cut").textContent = plot.cut ? "A few values of the steering angle or the acceleration lie outside the panels; “Full range” shows them." : "";
    time.max = (Math.floor(plot.end / data.step) * data.step).toFixed(6);
    time.step = data.step;
    clock();
  }

  function say() {
    var recorded = paths.recorded(now), roles = about.roles[now];
    var words = [side(now) + " departure, scenario " + about.index[now] + (roles.length ? " (" + roles.join(", ") + ")" : "") + ": " +
      seconds(about.T[now]) + " at " + LDC.number(about.v_mean[now], 1) + " m/s. Without control the edge gets " + LDC.number(recorded.deepest, 2) + " m beyond the line."];
    chosen.forEach(function (d) {
      var line = paths.driven(d, now), title = data.designs[d].title;
      if (!line) { words.push(title + ": no path here (" + without(d, now) + ")."); return; }
      words.push(title + " takes over at " + seconds(line.t[0]) + ", gets " + LDC.number(paths.fact("deepest", d, now), 2) + " m beyond the line, S " + LDC.number(paths.fact("S", d, now)) + " m·s (" + change(d, now) + ").");
    });
    if (!chosen.length) words.push("No design is chosen.");
    var said = find("said");
    said.textContent = "";
    said.appendChild(LDC.symbols(words.join(" ")));
  }

  function show(k) {
    now = k;
    var place = order.indexOf(now);
    number.value = about.index[now];
    find("previous").disabled = place === 0;
    find("next").disabled = place === order.length - 1;
    var option = role.selectedOptions[0];
    if (!option || Number(option.value) !== now) {
      option = Array.from(role.options).find(function (one) { return Number(one.value) === now; });
      role.selectedIndex = option ? option.index : 0;
    }
    refresh();
  }
  // What was said about designs goes with the next action.
  function note(text) { find("refused").textContent = text; }
  function refresh() {
    note("");
    chosen = boxes.filter(function (box) { return box.checked; }).map(function (box) { return Number(box.value); });
    draw();
    tables();
    say();
  }
  function offer(text) { find("offer").textContent = text; }

  function options() {
    role.appendChild(LDC.el("option", { value: -1 }, "by number"));
    var groups = {};
    about.index.forEach(function (_, k) {
      about.roles[k].forEach(function (one) {
        var group = groups[side(k)] || (groups[side(k)] = []);
        group.push(LDC.el("option", { value: k }, side(k) + ": " + one + " (scenario " + about.index[k] + ")"));
      });
    });
    ["Left", "Right"].forEach(function (one) {
      if (groups[one]) role.appendChild(LDC.el("optgroup", { label: one }, groups[one]));
    });
  }

  role.addEventListener("change", function () {
    offer("");
    if (Number(role.value) >= 0) show(Number(role.value));
    else { offer("Type a scenario’s number, or go on with Previous and Next."); number.focus(); }
  });
  number.addEventListener("change", function () {
    var wanted = Number(number.value), from = about.index[now];
    if (number.value === "" || !Number.isFinite(wanted)) { offer("A scenario’s number is a whole number from " + data.numbers.join(" to ") + "."); number.value = from; return; }
    var k = paths.nearest(wanted);
    if (about.index[k] === wanted) { offer(""); show(k); return; }
    var place = order.indexOf(now) + (wanted > from ? 1 : -1);
    if (Math.abs(wanted - from) === 1 && order[place] !== undefined) k = order[place];  // an arrow of the field: go on to the neighbour
    offer("Scenario " + wanted + " is not in this page; scenario " + about.index[k] + " is shown, " +
      (Math.abs(wanted - from) === 1 ? "the next one that is" : "the nearest one that is") + ". All numbers stand below the tables.");
    show(k);
  });
  [["previous", -1], ["next", 1]].forEach(function (one) {
    find(one[0]).addEventListener("click", function () {
      offer("");
      show(order[Math.min(Math.max(order.indexOf(now) + one[1], 0), order.length - 1)]);
    });
  });
  boxes.forEach(function (box) {
    box.addEventListener("change", function () {
      var over = boxes.filter(function (one) { return one.checked; }).length > MOST;
      if (over) box.checked = false;
      refresh();
      if (over) note("Four designs at most are drawn at once: take one away first.");
    });
  });
  zoom.addEventListener("change", function () { note(""); draw(); });
  full.addEventListener("change", function () { note(""); draw(); });
  time.addEventListener("input", function () { note(""); clock(); });
  document.addEventListener("ldc:departures", function (event) {
    var d = data.designs.findIndex(function (one) { return one.place === event.detail.place; });
    var said = "", id = event.detail.id || (LDC.designs ? LDC.designs.place(event.detail.place).id : "ID");
    if (d < 0) said = "The explorer holds no paths of design " + id + "; ldc report DIR --design " + id + " writes the page with them.";
    else if (!boxes[d].checked) {
      var on = boxes.filter(function (one) { return one.checked; });
      if (on.length >= MOST) {
        on[MOST - 1].checked = false;
        var gone = data.designs[Number(on[MOST - 1].value)];
        said = data.designs[d].title + ", " + data.designs[d].id + ", takes the place of " + gone.title + ", " + gone.id + ": four designs at most are drawn at once.";
      }
      boxes[d].checked = true;
      refresh();
    }
    note(said);
  });
  var width = 0;
  window.addEventListener("resize", function () {
    if (find("plot").clientWidth !== width) { width = find("plot").clientWidth; draw(); }
  });

  options();
  find("numbers").textContent = order.map(function (k) { return about.index[k]; }).join(", ");
  var start = about.roles.findIndex(function (roles) { return roles.indexOf("asked for") >= 0; });
  if (start < 0) start = about.roles.findIndex(function (roles) { return roles.indexOf("median reduction") >= 0; });
  show(Math.max(start, 0));
  width = find("plot").clientWidth;
})();
