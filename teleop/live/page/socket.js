/* -- the socket: a document has HELLO, ENDED, `heard`, `dropped` and `finished` -------------------------------- */
let socket = null, tries = 0, was = false, heardAt = 0, lookedAt = 0, mute = false;  // when the server said something, when that was looked at; it stands still
function sent(message) {
  if (!socket || socket.readyState !== 1) return false;
  socket.send(JSON.stringify(message));
  return true;
}
function connection(text) {
  const open = socket && socket.readyState === 1;
  $("conn").className = open && !lost && !mute ? "" : "lost";
  $("conn").textContent = text || (mute ? "no answer" : lost ? lost + " is lost" : open ? "connected" : "connecting");
}
function listen() {  // a server that stands still, or a cut way to it, closes no socket: it says something four times a second, or is missed
  const now = performance.now();
  if (now - lookedAt > 1500) heardAt = now;  // it is this page that was asleep
  lookedAt = now;
  const silent = !!hello && !!socket && socket.readyState === 1 && now - heardAt > 2e3;  // a first greeting may take long
  if (silent === mute) return;
  mute = silent;
  connection();
  dirty = true;
  if (mute) say("error", "The server does not answer: it hangs, or the connection is cut. The page shows what came last.");
  else say("info", "The server answers again.");
}
const hex = bytes => [...new Uint8Array(bytes)].map(byte => byte.toString(16).padStart(2, "0")).join("");
async function proven() {  // whoever listens at the port by now is sent the token only after a proof that it has it
  const text = new TextEncoder(), hmac = {name: "HMAC", hash: "SHA-256"}, nonce = hex(crypto.getRandomValues(new Uint8Array(16)));
  const token = text.encode(new URLSearchParams(location.search).get("token"));
  const answer = await fetch("/proof?nonce=" + nonce, {signal: AbortSignal.timeout(4e3)});
  const key = await crypto.subtle.importKey("raw", token, hmac, false, ["sign"]);
  return await answer.text() === hex(await crypto.subtle.sign("HMAC", key, text.encode("proof " + nonce)));
}
async function connect() {
  if ((was || tries) && !await proven().catch(() => false)) return closed("");
  const url = (location.protocol === "https:" ? "wss://" : "ws://") + location.host + "/ws" + location.search;
  socket = new WebSocket(url);
  socket.onopen = () => {
    tries = 0;
    heardAt = performance.now();
    lost = null;
    connection();
    if (was) say("info", HELLO);
    was = true;
  };
  socket.onmessage = event => {
    heardAt = performance.now();
    const m = JSON.parse(event.data);
    if (heard[m.type]) heard[m.type](m);
  };
  socket.onclose = event => closed(event.reason);
}
function closed(reason) {
  if (finished()) return connection();
  const wait = Math.min(4, .5 * 2 ** tries++);
  mute = false;
  dropped();
  connection(`not connected, next try in ${wait} s`);
  if (was || tries === 2 || reason) say("error", reason || "The server does not answer: it has ended, or the connection is cut. " + ENDED);
  dirty = true;
  setTimeout(connect, wait * 1e3);
}
