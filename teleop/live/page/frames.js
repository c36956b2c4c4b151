/* -- frames ------------------------------------------------------------------------------------------------------- */
let before = 0, scaled = 0, stripped = 0;
function frame(now) {
  const dt = clip((now - before) / 1e3, 0, .1);
  before = now;
  frames++;
  if (pad) gamepad(dt);
  flush(now);
  if (dirty || dots.length) { draw(dt); }
  if (now - scaled > 250) { rescale(); overview(); scaled = now; }
  if ((dirty || strips.some(one => one.whole)) && (!still.matches || now - stripped > 250)) { strips.forEach(drawStrip); stripped = now; }
  dirty = false;
  requestAnimationFrame(frame);
}
function size() {
  fit();
  for (const one of strips) one.whole = true;
}
new ResizeObserver(size).observe(document.querySelector("main"));
dark.onchange = colours;
colours();
size();
setInterval(() => { flush(performance.now()); listen(); }, 200);
if ("WebSocket" in window) connect();
else say("error", "This browser has no WebSocket, which the page needs: open it in a current Firefox, Chrome, Edge or Safari.");
requestAnimationFrame(frame);
