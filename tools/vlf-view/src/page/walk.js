// The walkthrough in a browser: keys and mouse go to the server, which takes the pictures.
"use strict";

const canvas = document.getElementById("picture");
const screen2d = canvas.getContext("2d", { alpha: false });
const lines = document.getElementById("lines");
const query = location.search;
const session = Math.floor(Math.random() * Number.MAX_SAFE_INTEGER);

// Pictures over this link take so many milliseconds more than their making; moving ones get coarser
// and coarser until they keep up with the hand.
const SLOW = 60, FAST = 25;
let coarse = 1, quality = 85;

let events = [];
let framing = false, telling = null, wake = null;

async function post(path, what) {
  const answer = await fetch(path + query, { method: "POST", body: JSON.stringify(what) });
  if (!answer.ok) throw new Error(await answer.text());
  return answer;
}

// While a picture is being made, what happens is told at once: it may be out of date already.
async function tell() {
  while (framing && events.length) {
    const now = events;
    events = [];
    await post("input", { session, events: now });
  }
  telling = null;
}

function happened(event) {
  events.push(event);
  if (framing && !telling) telling = tell().catch(() => { telling = null; });
  if (wake) wake();
}

function fit() {
  const scale = window.devicePixelRatio || 1;
  const within = (n) => Math.min(4096, Math.max(1, Math.round(n * scale)));
  return [within(canvas.clientWidth), within(canvas.clientHeight)];
}

async function frame() {
  const began = performance.now();
  const now = events;
  events = [];
  framing = true;
  const answer = await post("frame", { session, events: now, size: fit(), coarse, quality });
  const bytes = await answer.arrayBuffer();
  framing = false;
  const length = new DataView(bytes).getUint32(0, true);
  const told = JSON.parse(new TextDecoder().decode(new Uint8Array(bytes, 4, length)));
  if (bytes.byteLength > 4 + length) {
    const image = await createImageBitmap(new Blob([new Uint8Array(bytes, 4 + length)]));
    show(image, told);
    if (told.coarse > 1 || told.samples === 1) pace(performance.now() - began - told.ms);
  }
  const text = told.lines.join("\n");
  if (lines.textContent !== text) lines.textContent = text;
  told.wishes.forEach(fulfil);
  return told.done;
}

function show(image, told) {
  const [width, height] = told.size;
  if (canvas.width !== width || canvas.height !== height) {
    canvas.width = width;
    canvas.height = height;
  }
  const [x, y] = told.margin.map((m) => m / told.coarse);
  screen2d.imageSmoothingEnabled = told.coarse > 1;
  screen2d.drawImage(image, x, y, width / told.coarse, height / told.coarse, 0, 0, width, height);
  canvas.dataset.pass = told.coarse + "/" + told.samples;
}

function pace(link) {
  if (link > SLOW) {
    coarse = Math.min(8, coarse + 1);
    quality = Math.max(40, quality - 10);
  } else if (link < FAST) {
    coarse = Math.max(1, coarse - 1);
    quality = Math.min(90, quality + 5);
  }
}

function fulfil(wish) {
  if (wish.copy) {
    if (navigator.clipboard) navigator.clipboard.writeText(wish.copy).catch(() => {});
  } else if (wish.screenshot) {
    canvas.toBlob((blob) => {
      const link = document.createElement("a");
      link.href = URL.createObjectURL(blob);
      link.download = "view.png";
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    });
  }
}

async function run() {
  for (;;) {
    try {
      if (telling) await telling;
      const done = await frame();
      if (done && !events.length) {
        // Now and then, since there may be news.
        await new Promise((resolve) => { wake = resolve; setTimeout(resolve, 1000); });
        wake = null;
      }
    } catch (error) {
      framing = false;
      lines.textContent = "no answer: " + error.message;
      await new Promise((resolve) => setTimeout(resolve, 1000));
    }
  }
}

const locked = () => document.pointerLockElement === canvas;

function capture() {
  if (locked()) document.exitPointerLock();
  else Promise.resolve(canvas.requestPointerLock()).catch(() => {});
}

const own = {
  Tab: capture,
  KeyF: () => document.fullscreenElement ? document.exitFullscreen()
    : document.documentElement.requestFullscreen().catch(() => {}),
};

function key(event, down) {
  // What the browser itself does with Ctrl, Alt and the like; but Ctrl with a digit saves a view.
  const digit = /^(Digit|Numpad)\d$/.test(event.code);
  if (event.altKey || event.metaKey || (event.ctrlKey && !digit && down)) return;
  if (event.code === "F11" || event.code === "F5" || event.code === "F12") return;
  event.preventDefault();
  if (event.repeat) return;
  if (own[event.code]) {
    if (down) own[event.code]();
    return;
  }
  const text = event.key.length === 1 ? event.key : "";
  happened({ Key: [event.code, text, down, event.ctrlKey || event.shiftKey] });
}

window.addEventListener("keydown", (event) => key(event, true));
window.addEventListener("keyup", (event) => key(event, false));
window.addEventListener("blur", () => happened("Blur"));
window.addEventListener("resize", () => { if (wake) wake(); });

// Where the button went down, and whether the pointer has left that place since: then it drags.
// Told by places: browsers report movements of the pointer from before the button as well.
let press = null;
canvas.addEventListener("pointerdown", (event) => {
  if (event.button !== 0 || locked()) return;
  press = { x: event.clientX, y: event.clientY, drags: false };
  canvas.setPointerCapture(event.pointerId);
});
canvas.addEventListener("pointermove", (event) => {
  const { movementX: x, movementY: y } = event;
  if (locked()) {
    happened({ Look: [x, y] });
  } else if (press) {
    press.drags ||= Math.hypot(event.clientX - press.x, event.clientY - press.y) >= 4;
    if (press.drags) happened({ Drag: [x, y] });
  }
});
canvas.addEventListener("pointerup", () => {
  if (press && !press.drags) capture();
  press = null;
});
canvas.addEventListener("wheel", (event) => {
  event.preventDefault();
  const notches = event.deltaMode === 0 ? event.deltaY / 100 : event.deltaY / 3;
  happened({ Wheel: -notches });
}, { passive: false });

run();
