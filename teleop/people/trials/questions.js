/* -- questionnaires: nothing is chosen before somebody chooses it -------------------------------------------------- */
const ENDS = {"performance": ["perfect", "failure"]};
let given = () => ({}), left = [];
function field(name, ...inside) {
  const at = document.createElement("fieldset");
  at.append(Object.assign(document.createElement("legend"), {textContent: name}), ...inside);
  return at;
}
function button(text, onclick) { return Object.assign(document.createElement("button"), {type: "button", textContent: text, onclick}); }
function answered() { $("next").disabled = left.some(is => !is()); }
function ends(low, high) {
  const at = Object.assign(document.createElement("div"), {className: "ends"});
  at.append(...[low, high].map(text => Object.assign(document.createElement("span"), {textContent: text})));
  return at;
}
function chosen(buttons, i) {
  buttons.forEach((one, k) => one.setAttribute("aria-pressed", String(k === i)));
  answered();
}
function rating(name) {  // a scale without a preset thumb
  const input = Object.assign(document.createElement("input"), {type: "range", min: 0, max: 100, step: 5, value: 50, className: "unset"});
  input.setAttribute("aria-label", name);
  input.setAttribute("aria-valuetext", "not answered");
  const set = () => { input.className = ""; input.setAttribute("aria-valuetext", input.value); answered(); };
  input.oninput = input.onclick = input.onpointerup = set;
  input.onkeydown = event => { if (event.key === " " || event.key === "Enter") { event.preventDefault(); set(); } };
  left.push(() => input.className === "");
  return {at: field(name[0].toUpperCase() + name.slice(1), input, ends(...(ENDS[name] || ["very low", "very high"]))), value: () => +input.value};
}
function points(name, count) {
  let value = null;
  const buttons = Array.from({length: count}, (_, i) => button(String(i + 1), () => { value = i + 1; chosen(buttons, i); })), row = document.createElement("div");
  row.className = "points";
  row.append(...buttons);
  left.push(() => value !== null);
  return {at: field(name, row, ends("not at all", "completely")), value: () => value};
}
function writing(name) {
  const at = Object.assign(document.createElement("textarea"), {maxLength: 2000});
  at.setAttribute("aria-label", name);
  return {at: field(name, at), value: () => at.value};
}
function pair(items, [a, b]) {
  let value = null;
  const buttons = [a, b].map((item, i) => button(items[item], () => { value = item; chosen(buttons, i); })), row = document.createElement("div");
  row.className = "pair";
  row.append(...buttons);
  left.push(() => value !== null);
  return {at: row, value: () => value};
}
function questions(m) {
  const form = $("form");
  left = [];
  if (m.kind === "tlx") {
    words(TITLES.question, "How much of each was there in the trials before? Click on each scale where it fits; for performance, the left end is perfect.");
    const ratings = m.items.map(rating), pairs = m.pairs.map(each => pair(m.items, each));
    form.replaceChildren(...ratings.map(each => each.at), ...(pairs.length ? [field("Of each pair, press what mattered more for how hard it was", ...pairs.map(each => each.at))] : []));
    given = () => ({ratings: ratings.map(each => each.value()), chosen: pairs.map(each => each.value())});
  } else {
    words(TITLES.question, m.kind === "text" ? "Write as much or as little as you like." : "How far do you agree?");
    const all = m.items.map(item => m.kind === "text" ? writing(item) : points(item, m.points));
    form.replaceChildren(...all.map(each => each.at));
    given = () => ({[m.kind === "text" ? "texts" : "points"]: all.map(each => each.value())});
  }
  form.onsubmit = event => event.preventDefault();
  answered();
}
