// Search in the ranking: words that a row shows, and gains compared as numbers ("r_delta = 10", "y_s < 0.2").
(function () {
  "use strict";
  var designs = LDC.designs;
  if (!designs) return;
  var GREEK = { α: "alpha", β: "beta", δ: "delta", κ: "kappa", λ: "lambda", μ: "mu", ω: "omega", φ: "phi", ψ: "psi", ρ: "rho", σ: "sigma", θ: "theta" };
  var CONDITION = /([^\s,=<>]+)\s*(<=|>=|=|<|>)\s*([^\s,]*)/g;
  var TESTS = {
    "=": function (a, b) { return a === b; }, "<": function (a, b) { return a < b; }, ">": function (a, b) { return a > b; },
    "<=": function (a, b) { return a <= b; }, ">=": function (a, b) { return a >= b; }
  };
  var texts = [], known = { ys: true };
  designs.laws.forEach(function (law) { law.gains.forEach(function (gain) { known[plain(gain.name)] = true; }); });

  // Text as it is compared: indices, Greek letters and minus signs as they are typed.
  function plain(text) {
    return text.toLowerCase().replace(/\u2212/g, "-").replace(/_/g, "").replace(/[α-ω]/g, function (letter) { return GREEK[letter] || letter; });
  }
  function haystack(i) {
    if (texts[i] === undefined) {
      var one = designs.place(i), said = designs.gains(i).map(function (gain) { return gain.name + "=" + gain.text + " " + gain.unit; });
      var missed = designs.unmet(i).concat(designs.freshUnmet(i)).map(function (text) { return "misses " + text; });
      texts[i] = plain([one.label, one.law, one.id].concat(said, designs.tags(i), missed).join(" "));
    }
    return texts[i];
  }
  // Values of a gain or of y_s: in full, and rounded as shown.
  function values(i, name) {
    var one = designs.place(i);
    if (name === "ys") return designs.is("passive", i) ? null : [one.y_s_toml, one.y_s];
    var gain = designs.gains(i).filter(function (of) { return plain(of.name) === name; })[0];
    return gain ? [gain.toml, gain.text] : null;
  }
  function holds(i, condition) {
    var found = values(i, condition.name), wanted = Number(condition.value);
    if (!found) return false;
    if (condition.value === "" || (Number.isNaN(wanted) && condition.sign === "=")) return plain(found[1]).indexOf(condition.value) === 0;
    var numbers = found.map(function (text) { return Number(plain(text)); });
    return TESTS[condition.sign](numbers[0], wanted) || (condition.sign === "=" && numbers[1] === wanted);
  }

  // Whether a design, by its place, is what the text asks for.
  LDC.search = function (text) {
    var conditions = [], rest = plain(text).replace(CONDITION, function (all, name, sign, value) {
      if (!known[name]) return all;
      conditions.push({ name: name, sign: sign, value: value });
      return " ";
    });
    var words = rest.split(/[\s,]+/).filter(Boolean);
    return function (i) {
      return conditions.every(function (one) { return holds(i, one); })
        && (!words.length || words.every(function (word) { return haystack(i).indexOf(word) >= 0; }));
    };
  };
})();
