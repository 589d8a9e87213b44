// Everything on one design, in a dialog that opens wherever a design is chosen.
(function () {
  "use strict";
  var designs = LDC.designs;
  if (!designs) return;
  var el = LDC.el, data = designs.data, back = null, dialog = null, content = null;

  // The design as a table of a study file.
  function snippet(i) {
    var one = designs.place(i), gains = designs.gains(i).filter(function (gain) {
      // A reading of its own is written even where it is the law's default: else the study's case decides it.
      return gain.name === "convention" ? gain.toml !== "\"case\"" : gain.swept || gain.changed;
    });
    var lines = ["[[design]]", "law = " + JSON.stringify(one.law), "y_s = " + one.y_s_toml];
    if (gains.length) lines.push("", "[design.gains]");
    return lines.concat(gains.map(function (gain) { return gain.name + " = " + gain.toml; })).join("\n") + "\n";
  }
  function copy(text, from, said) {
    function selected() {
      var range = document.createRange();
      range.selectNodeContents(from);
      window.getSelection().removeAllRanges();
      window.getSelection().addRange(range);
      said.textContent = document.execCommand("copy") ? "Copied." : "Selected: copy it with the keyboard.";
    }
    if (navigator.clipboard && window.isSecureContext) {
      navigator.clipboard.writeText(text).then(function () { said.textContent = "Copied."; }, selected);
    } else selected();
  }

  function region(title, table) {
    return el("div", { "class": "scroll", tabindex: "0", role: "region", "aria-label": title }, table);
  }
  function heads(titles) {
    return el("thead", {}, el("tr", {}, titles.map(function (title, k) {
      return el("th", { scope: "col", "class": k ? "n" : null }, title);
    })));
  }
  function gainsTable(i) {
    var rows = designs.gains(i).map(function (gain) {
      var value = [gain.text];
      if (gain.unit) value.push(" ", el("small", {}, gain.unit));
      return el("tr", {}, [
        el("th", { scope: "row" }, [LDC.symbols(gain.name), el("br"), el("small", {}, LDC.symbols(gain.about))]),
        el("td", { "class": "n" }, value),
        el("td", { "class": "n" }, gain.changed ? gain.fallback : "as here")
      ]);
    });
    if (!designs.is("passive", i)) {
      rows.unshift(el("tr", {}, [
        el("th", { scope: "row" }, [LDC.symbols("y_s"), el("br"), el("small", {}, "threshold of the trigger")]),
        el("td", { "class": "n" }, [designs.place(i).y_s, " ", el("small", {}, "m")]), el("td", { "class": "n" }, "–")
      ]));
    }
    if (!rows.length) return el("p", {}, "The law has no gains.");
    return region("Gains", el("table", { "class": "facts-of" }, [
      el("caption", {}, el("span", {}, "Gains")), heads(["Gain", "Value", "Default"]), el("tbody", {}, rows)
    ]));
  }
  // This design beside others, each once.
  function beside(i) {
    var found = [{ place: i, title: "This design" }];
    [[designs.winner, "Winner"], [designs.baseline, "Baseline"], [designs.passive, "No control"]].forEach(function (one) {
      if (one[0] < 0 || one[0] === i) return;
      var same = found.filter(function (other) { return other.place === one[0]; })[0];
      if (same) same.title += ", " + one[1].toLowerCase();
      else found.push({ place: one[0], title: one[1] });
    });
    return found;
  }
  function figuresTable(i) {
    var others = beside(i), bodies = Object.keys(data.groups).map(function (group) {
      var lines = designs.figures.filter(function (one) { return one.group === group; }).map(function (one) {
        var ends = designs.interval(one.name), said = others.map(function (other) {
          var cell = [designs.shown(one.name, other.place)];
          if (ends && other.place === i && !Number.isNaN(ends.low[i])) {
            cell.push(el("br"), el("small", {}, "[" + LDC.number(ends.low[i] * one.scale, one.digits) + " to " + LDC.number(ends.high[i] * one.scale, one.digits) + "]"));
          }
          return el("td", { "class": "n" }, cell);
        });
        return el("tr", {}, [el("th", { scope: "row" }, LDC.symbols(designs.titled(one)))].concat(said));
      });
      return lines.length && el("tbody", {}, [
        el("tr", { "class": "group" }, el("th", { scope: "rowgroup", colspan: 1 + others.length }, data.groups[group]))
      ].concat(lines));
    }).filter(Boolean);
    return region("Figures", el("table", { "class": "facts-of limits" }, [
      el("caption", {}, el("span", {}, "Figures, " + data.case)),
      heads(["Figure"].concat(others.map(function (other) { return other.title; })))
    ].concat(bodies)));
  }
  function compared(i) {
    var lines = [["difference", "Difference of mean S to the first of the ranking"], ["baseline_difference", "Difference of mean S to the baseline"],
      ["fresh_S", "Mean S on fresh departures"], ["fresh_difference", "Difference to the first there"],
      ["fresh_baseline_difference", "Difference to the baseline there"], ["optimism", "Optimism of the search"]];
    var said = lines.map(function (line) {
      var of = designs.interval(line[0]);
      if (!of || Number.isNaN(of.value[i]) || (of.value[i] === 0 && of.low[i] === 0 && of.high[i] === 0)) return null;
      var show = line[0] === "fresh_S" ? LDC.number : LDC.signed;
      return el("li", {}, line[1] + ": " + show(of.value[i]) + " m·s [" + LDC.number(of.low[i]) + " to " + LDC.number(of.high[i]) + "]");
    }).filter(Boolean);
    return said.length ? el("ul", {}, said) : document.createDocumentFragment();
  }
  function requirements(i) {
    if (!data.require.length) return document.createDocumentFragment();
    var missed = LDC.table.missed(i);
    if (!missed.length) return el("p", {}, ["Meets all requirements: ", LDC.symbols(data.require.join(", ")), "."]);
    var parts = ["Requirements: "];
    missed.forEach(function (one, k) { parts.push(k ? ", " : "", one); });
    return el("p", {}, parts.concat("."));
  }
  // The way to the explorer, where it holds paths of the design.
  function departures(i) {
    if (!document.getElementById("departures")) return document.createDocumentFragment();
    var held = LDC.data("departures"), has = Boolean(held) && held.designs.some(function (one) { return one.place === i; });
    var parts = [el("button", { type: "button", disabled: !has, click: function () {
      back = document.getElementById("departures");
      document.dispatchEvent(new CustomEvent("ldc:departures", { detail: { place: i } }));
      dialog.close();
    } }, "Show in departures")];
    if (!has) parts.push(el("span", { "class": "small" }, ["This page holds no paths of it: ", el("code", {}, "ldc report DIR --design " + designs.place(i).id), " adds them."]));
    return el("div", { "class": "controls" }, parts);
  }
  function fill(i) {
    var one = designs.place(i), rank = designs.rank(i), text = snippet(i), code = el("code", {}, text);
    var said = el("span", { role: "status", "class": "small" });
    return [
      el("p", { "class": "kind" }, rank ? "Rank " + rank + " of " + designs.ranked.toLocaleString("en") + (designs.ranked < designs.count ? " ranked designs" : "") : "Not ranked"),
      el("h2", { id: "details-title" }, LDC.symbols(one.label.replace(/-(?=\d)/g, "\u2212"))),
      el("p", {}, [el("code", {}, one.law), " · design ", el("code", {}, one.id)].concat(LDC.table.tags(i))),
      requirements(i), compared(i),
      departures(i), gainsTable(i), figuresTable(i),
      el("h3", {}, "This design alone"),
      el("p", {}, "In a study file, in place of its [[design]] tables; gains that are not written keep their defaults."),
      el("pre", { tabindex: "0" }, code),
      el("p", { "class": "controls" }, [el("button", { type: "button", click: function () { copy(text, code, said); } }, "Copy"), said])
    ];
  }
  function make() {
    content = el("div", { "class": "inside" });
    dialog = el("dialog", { id: "details", "aria-labelledby": "details-title" }, [
      el("button", { type: "button", "class": "close", "aria-label": "Close the details", click: function () { dialog.close(); } }, "Close"), content
    ]);
    dialog.addEventListener("click", function (event) { if (event.target === dialog) dialog.close(); });
    dialog.addEventListener("close", function () {
      if (!back || !document.contains(back)) return;
      if (back.id === "departures") {
        back.setAttribute("tabindex", "-1");
        back.scrollIntoView();
      }
      back.focus();
      back = null;
    });
    document.body.appendChild(dialog);
  }
  document.addEventListener("ldc:design", function (event) {
    var i = event.detail.place;
    if (!(i >= 0 && i < designs.count)) return;
    if (!dialog) make();
    if (!dialog.open) back = document.activeElement;
    while (content.firstChild) content.removeChild(content.firstChild);
    fill(i).forEach(function (node) { content.appendChild(node); });
    if (!dialog.open) dialog.showModal();
    dialog.scrollTop = 0;
  });
})();
