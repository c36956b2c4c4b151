const HELLO = "", ENDED = "Please ask the experimenter.", WORDS = ["handle", "robot"];
const ofAll = to => to;
let screen = {screen: ""}, since = 0, measuring = [];
const finished = () => document.body.className === "over", dropped = () => { drag = null; target = null; };
const heard = {
  stage(m) {
    hello = {...m, words: WORDS, ruler: false};
    view = {c: m.wall == null ? 0 : .08 * Math.sign(m.wall) * m.span, span: m.span};
    row = null;
    dirty = true;
  },
  rows(m) {
    if (screen.screen !== "trial") return;
    row = m;
    dirty = true;
  },
  screen: show,
  said(m) { say(m.level, m.text); },
};
const TITLES = {
  consent: "Welcome", instructions: "What you do", break: "Time for a break", stopped: "Stopped: the force is off",
  end: "Thank you: that was all", withdrawn: "You have withdrawn", question: "A few questions",
};
function words(title, ...paragraphs) {
  const at = $("words"), small = screen.screen === "trial" || screen.screen === "turn" || screen.screen === "record";
  at.className = small ? "card small" : "card";
  at.replaceChildren(Object.assign(document.createElement("h2"), {textContent: title}),
    ...paragraphs.filter(Boolean).map(text => Object.assign(document.createElement("p"), {textContent: text})));
  return at;
}
function show(m) {
  const before = screen.screen, interval = m.intervals > 1 ? (m.interval > 1 ? "Second" : "First") : "";
  screen = m;
  since = performance.now();
  if (!["consent", "break"].includes(before) || before !== m.screen) say("info", "");
  const is = (...names) => names.includes(m.screen), moving = is("turn", "trial", "record");
  document.body.className = is("end", "withdrawn") ? "over" : is("trial") ? "live" : "";
  $("progress").textContent = is("consent", "instructions", "end", "withdrawn") ? "" : m.training ? "practice" : `${Math.min(m.done + (moving || is("answer") ? 1 : 0), m.trials)} of ${m.trials}`;
  $("box").hidden = !moving;
  $("ready").hidden = !is("turn", "record");
  $("invite").hidden = !is("trial");
  $("choice").hidden = !is("answer");
  $("form").hidden = !is("question");
  $("next").hidden = !is("consent", "instructions", "break", "stopped", "question");
  $("next").disabled = is("question");
  $("next").textContent = is("consent") ? "I agree, and take part" : is("instructions") ? "Begin" : is("question") ? "Send" : "Go on";
  if (is("consent")) consent(m);
  else if (is("instructions")) words(m.resumed ? "Welcome back" : TITLES.instructions, m.text, m.pointer
    ? "Drag the handle with the mouse or a finger, or move it with the arrow keys. The further you pull your hand away from the handle, the harder you push."
    : "Hold the handle of the device in front of you. Before each trial bring it back to where it began, and hold it still.",
    m.training > 0 ? "The first trials are for practice." : "", "Before each trial there is a short pause. You can stop at any time with the red button below, or with the Escape key: the force is then off.");
  else if (is("turn")) { words(interval ? `${interval} ${m.noun}` : "Get ready"); $("ready").firstChild.textContent = interval === "Second" ? `Now the second ${m.noun} ...` : "Get ready ..."; dropped(); }
  else if (is("record")) { words("One moment"); $("ready").firstChild.textContent = "One moment ..."; }
  else if (is("trial")) { words(interval ? `${interval} ${m.noun}${m.noun === "wall" ? ": press it" : ""}` : m.text); dropped(); stage.focus({preventScroll: true}); }
  else if (is("break")) rest();
  else if (is("question")) questions(m);
  else words(TITLES[m.screen] || m.text, {
    answer: "Press a button, or the key 1 or 2.", stopped: "Go on when you are ready, or ask the experimenter.",
    end: "Please tell the experimenter that you are done.", withdrawn: "All that was recorded of you has been deleted. Please tell the experimenter.",
  }[m.screen]);
  if (is("stopped")) say("info", "");
  fit();
  if (!moving) scrollTo(0, 0);
}
function consent(m) {
  const at = words(TITLES.consent, ...(m.text || "You take part in a study.").split("\n\n"), "You can stop at any time, and withdraw: all that was recorded of you is then deleted."), label = document.createElement("label");
  const input = Object.assign(document.createElement("input"), {id: "code", autocomplete: "off", maxLength: 40, onkeydown: event => { if (event.key === "Enter") $("next").click(); }});
  label.append("Your code, as the experimenter gave it to you", input);
  at.append(label);
}
function rest() {
  const left = Math.ceil(screen.seconds - (performance.now() - since) / 1e3);
  $("next").disabled = left > 0;
  words(TITLES.break, left > 0 ? `Rest your hand and your eyes. You can go on in ${left} s.` : "Go on when you are ready.");
}
$("next").onclick = () => {
  if (screen.screen === "consent") sent({type: "consent", code: $("code").value});
  else if (screen.screen === "question") sent({type: "answers", ...given()});
  else sent({type: "next"});
};
const answer = interval => { if (screen.screen === "answer") sent({type: "answer", interval}); };
$("first").onclick = () => answer(1);
$("second").onclick = () => answer(2);
$("stop").onclick = () => { dropped(); sent({type: "stop"}); };
$("leave").onclick = () => { sent({type: "stop"}); $("sure").showModal(); };
$("stay").onclick = () => $("sure").close();
$("delete").onclick = () => { $("sure").close(); sent({type: "withdraw"}); };
onkeydown = event => {
  if (event.ctrlKey || event.metaKey || event.altKey || $("sure").open) return;
  if (event.key === "Escape") $("stop").click();
  else if (event.target.tagName === "INPUT" || event.target.tagName === "TEXTAREA") return;
  else if ((event.key === "1" || event.key === "2") && !event.repeat) answer(+event.key);
  else if (screen.screen === "trial" && hello) nudge(event);
};
onblur = () => { if (screen.screen) sent({type: "focus"}); };
document.onvisibilitychange = () => { if (document.hidden) sent({type: "focus"}); };

/* -- frames ------------------------------------------------------------------------------------------------------- */
let before = 0;
function frame(now) {
  const dt = clip((now - before) / 1e3, 0, .1);
  before = now;
  if (measuring && socket && socket.readyState === 1 && measuring.push(now) > 30) {  // the screen's refresh, by the median
    const gaps = measuring.slice(1).map((t, i) => t - measuring[i]).sort((a, b) => a - b);
    sent({type: "screen", refresh: 1e3 / gaps[15]});
    measuring = null;
  }
  if (screen.screen === "trial") flush(now);
  if (screen.screen === "trial" && dirty) draw(dt);
  if (screen.screen === "turn") $("ready").lastChild.style.setProperty("--p", clip((now - since) / 1e3 / screen.seconds, 0, 1));
  dirty = false;
  requestAnimationFrame(frame);
}
setInterval(() => { if (screen.screen === "break") rest(); }, 250);
new ResizeObserver(fit).observe(document.querySelector("main"));
dark.onchange = palette;
queueMicrotask(() => { palette(); fit(); connect(); requestAnimationFrame(frame); });
