// The browser's end of `glhybrid view --web`: shows frames as they come, sends pointer and keys back.
"use strict";
const canvas = document.getElementById("view"), state = document.getElementById("state");
const paint = canvas.getContext("2d", { alpha: false });
const token = new URLSearchParams(location.search).get("token") || "";
const scheme = location.protocol === "https:" ? "wss" : "ws";
let socket = null, moved = null, ended = "", arrived = 0, painted = 0;

const KEYS = {
  ArrowLeft: "left_arrow", ArrowRight: "right_arrow", ArrowUp: "up_arrow", ArrowDown: "down_arrow",
  PageUp: "page_up", PageDown: "page_down", Home: "home", End: "end", Insert: "insert", Delete: "delete",
  Backspace: "backspace", Space: "space", Enter: "enter", NumpadEnter: "enter", Escape: "escape", Tab: "tab",
  ControlLeft: "left_ctrl", ControlRight: "right_ctrl", ShiftLeft: "left_shift", ShiftRight: "right_shift",
  AltLeft: "left_alt", AltRight: "right_alt", MetaLeft: "left_super", MetaRight: "right_super",
  Quote: "apostrophe", Comma: "comma", Minus: "minus", NumpadSubtract: "minus", Period: "period", Slash: "slash",
  Semicolon: "semicolon", Equal: "equal", NumpadAdd: "equal", BracketLeft: "left_bracket", Backslash: "backslash",
  BracketRight: "right_bracket", Backquote: "grave_accent",
};

function keyName(code) {
  const found = /^(?:Key|Digit|Numpad)([A-Z0-9])$/.exec(code) || /^(F(?:[1-9]|1[0-2]))$/.exec(code);
  return found ? found[1].toLowerCase() : KEYS[code] || null;
}

function send(...message) {
  if (socket && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
}

function tell(text) {
  state.textContent = text;
  state.style.display = text ? "block" : "none";
}

async function show(data) {
  const number = ++arrived, image = await createImageBitmap(data);
  if (number < painted) return send("ack");  // a small one has come later and was quicker
  painted = number;
  if (canvas.width !== image.width || canvas.height !== image.height) {
    canvas.width = image.width;
    canvas.height = image.height;
  }
  paint.drawImage(image, 0, 0);
  image.close();
  canvas.dataset.frames = String(Number(canvas.dataset.frames || 0) + 1);
  canvas.dataset.exact = data.type === "image/png" ? "1" : "0";
  send("ack");
}

function order(message) {
  if (message.title !== undefined) document.title = message.title;
  if (message.cursor !== undefined) {
    canvas.style.cursor = { hand: "pointer", text: "text", resize_ew: "ew-resize", resize_ns: "ns-resize" }[message.cursor] || "default";
  }
  if (message.clipboard !== undefined && navigator.clipboard) navigator.clipboard.writeText(message.clipboard).catch(() => {});
  if (message.bye !== undefined) tell(ended = `${message.bye}; reload the page to look again`);
}

function connect() {
  socket = new WebSocket(`${scheme}://${location.host}/events?token=${encodeURIComponent(token)}`);
  socket.binaryType = "arraybuffer";
  let opened = false;
  socket.onopen = () => { opened = true; ended = ""; tell(""); resize(); };
  socket.onmessage = (event) => {
    if (typeof event.data === "string") return order(JSON.parse(event.data));
    const png = new Uint8Array(event.data, 0, 1)[0] === 0x89;
    show(new Blob([event.data], { type: png ? "image/png" : "image/jpeg" }));
  };
  socket.onclose = () => {
    if (ended) return tell(ended);
    tell(opened ? "the line is broken; connecting again ..." : "the viewer does not answer; trying again ...");
    setTimeout(connect, 1000);
  };
}

function resize() { send("size", window.innerWidth, window.innerHeight); }
window.addEventListener("resize", resize);
window.addEventListener("blur", () => send("focus", false));
window.addEventListener("focus", () => send("focus", true));
canvas.addEventListener("contextmenu", (event) => event.preventDefault());

// The pointer's place is sent once a frame at most, and always before a button.
function flush() {
  if (moved) send("move", ...moved);
  moved = null;
}
canvas.addEventListener("pointermove", (event) => {
  if (!moved) requestAnimationFrame(flush);
  moved = [event.clientX, event.clientY];
});
for (const [name, down] of [["pointerdown", true], ["pointerup", false]]) {
  canvas.addEventListener(name, (event) => {
    if (down) { canvas.setPointerCapture(event.pointerId); canvas.focus(); }
    moved = [event.clientX, event.clientY];
    flush();
    send("button", { 0: 0, 1: 2, 2: 1 }[event.button] ?? 9, down);
    event.preventDefault();
  });
}
canvas.addEventListener("wheel", (event) => {
  const unit = event.deltaMode === 0 ? 1 / 100 : event.deltaMode === 1 ? 1 / 3 : 1;
  send("wheel", -event.deltaX * unit, -event.deltaY * unit);
  event.preventDefault();
}, { passive: false });
for (const [name, down] of [["keydown", true], ["keyup", false]]) {
  window.addEventListener(name, (event) => {
    const key = keyName(event.code);
    if (key) send("key", key, down, event.repeat);
    if (down && event.key.length === 1 && !event.ctrlKey && !event.metaKey) send("text", event.key);
    if (key && !(event.ctrlKey && key !== "c" && key !== "q") && !event.metaKey) event.preventDefault();
  });
}
connect();
canvas.focus();
