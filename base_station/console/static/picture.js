// The live picture: asks for the next one as soon as the last is drawn, so that a slow line shows fewer, never old ones.

import * as drive from "./drive.js";
import * as emergency from "./emergency.js";
import { UNREACHABLE } from "./orders.js";
import { draw } from "./overlay.js";

const KEPT = 300;
const ANSWER_MS = 5000;
const OLD_MS = 2000; // a picture older than this is shown no longer
const decoder = new TextDecoder();

export const shown = { head: null, status: {}, times_ms: [], delays_ms: [], drag: null };
// The last picture's head, the last status, and of the last pictures when they were drawn, and how long after their
// last byte had reached the station (by the clocks of two machines, unless they are one).

let canvas, image = null;

// One canvas for the picture and what is drawn over it: a browser without a GPU composes each layer anew.
export function begin(host) {
  canvas = document.createElement("canvas");
  host.prepend(canvas);
  new ResizeObserver(redraw).observe(host);
  run();
  return canvas;
}

export function redraw() {
  const ratio = window.devicePixelRatio || 1;
  const width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  draw(canvas.getContext("2d", { alpha: false }), shown, image, ratio);
}

async function run() {
  for (let number = 0, line = null; ; ) {
    if (document.hidden) {
      await new Promise((visible) => document.addEventListener("visibilitychange", visible, { once: true }));
    }
    try {
      line ??= await connected();
      number = (await take(await line.ask(`${number} ${canvas.width}`))) ?? number;
    } catch (error) {
      line?.close();
      line = null;
      gone();
      await new Promise((later) => setTimeout(later, 500));
      number = 0;
    }
  }
}

// A websocket on which one question at a time has one answer: for thirty pictures a second, half as dear as requests.
async function connected() {
  const socket = new WebSocket(`${location.origin.replace("http", "ws")}/pictures`);
  socket.binaryType = "arraybuffer";
  const next = (event) =>
    new Promise((done, failed) => {
      const late = setTimeout(() => failed(new Error("no answer")), ANSWER_MS);
      const end = (then) => (told) => (clearTimeout(late), then(told));
      socket[`on${event}`] = end((told) => done(told.data));
      socket.onclose = end(() => failed(new Error("closed")));
    });
  await next("open");
  return {
    close: () => socket.close(),
    ask(question) {
      const answer = next("message");
      socket.send(question);
      return answer;
    },
  };
}

// Without a Blob, each of which the whole browser hears of, where that can be: browsers offer it on loopback and by TLS.
async function decoded(jpeg) {
  if (!window.ImageDecoder) return createImageBitmap(new Blob([jpeg], { type: "image/jpeg" }));
  const decoder = new ImageDecoder({ type: "image/jpeg", data: jpeg });
  try {
    return (await decoder.decode()).image;
  } finally {
    decoder.close();
  }
}

async function take(packet) {
  const length = new DataView(packet).getUint32(0, true);
  const told = JSON.parse(decoder.decode(new Uint8Array(packet, 4, length)));
  tell(told.status);
  const head = told.head;
  if (!head) {
    if (performance.now() - (shown.times_ms.at(-1) ?? -Infinity) > OLD_MS) shown.head = null;
    redraw();
    return null;
  }
  const end = 4 + length + 4 * head.features;
  head.points = new Uint16Array(packet.slice(4 + length, end));
  const next = await decoded(new Uint8Array(packet, end));
  if (shown.head?.width !== head.width || shown.head?.height !== head.height) {
    canvas.parentElement.style.setProperty("--aspect", head.width / head.height);
  }
  image?.close();
  image = next;
  shown.head = head;
  redraw();
  note(head.arrived_s);
  return head.number;
}

function note(arrived_s) {
  requestAnimationFrame(() => {
    const now = performance.now();
    shown.times_ms.push(now);
    shown.delays_ms.push(performance.timeOrigin + now - arrived_s * 1e3);
    for (const kept of [shown.times_ms, shown.delays_ms]) if (kept.length > KEPT) kept.shift();
  });
}

export function rate_hz() {
  const recent = shown.times_ms.filter((time) => performance.now() - time < 2000);
  return recent.length > 1 ? ((recent.length - 1) * 1e3) / (recent.at(-1) - recent[0]) : 0;
}

let told = "";

// Writes to the page only what has changed: each write has the browser compose the page once more than for its picture.
function tell(status) {
  shown.status = status;
  const text = JSON.stringify(status);
  if (text === told) return;
  told = text;
  emergency.show(status);
  drive.setBehaviour(status.behaviour ?? "");
  document.body.classList.toggle("replay", status.orders === false);
  banner(status.ended ? "The station has ended." : status.connected ? "" : status.link);
}

function gone() {
  told = "";
  shown.head = null;
  shown.status.link = shown.status.ended ? "The station has ended." : UNREACHABLE;
  redraw();
  drive.setBehaviour("");
  banner(`${shown.status.link} This page shows the last it knew.`);
}

function banner(text) {
  const box = document.getElementById("banner");
  box.hidden = !text;
  box.textContent = text;
  document.documentElement.style.setProperty("--banner", `${box.offsetHeight}px`); // the page makes room for it
}
