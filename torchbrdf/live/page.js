"use strict";
// Dragging asks for frames, one at a time: while one is on its way only the latest rotation is remembered.

const STEP = Math.PI / 36; // a key's turn, 5 degrees
const WATCH_MS = 2000;

const find = (id) => document.getElementById(id);
const canvases = Array.from(document.querySelectorAll("canvas"));
const size = canvases[0].width;
const pictureBytes = 4 * size * size;
const identity = [1, 0, 0, 0];

let rotation = identity; // unit quaternion w, x, y, z: probe.rotated(R)
let wanted = false; // a frame that shows the present rotation and exposure
let busy = false;
let frames = 0;
let arrivals = []; // of the last second

function product([a, b, c, d], [e, f, g, h]) {
  return [
    a * e - b * f - c * g - d * h,
    a * f + b * e + c * h - d * g,
    a * g - b * h + c * e + d * f,
    a * h + b * g - c * f + d * e,
  ];
}

// Turns the light about the world's axes: +X is right, +Y up, +Z towards the viewer; |vector| is the angle.
function turn(vector) {
  const angle = Math.hypot(...vector);
  if (angle === 0) return;
  const share = Math.sin(angle / 2) / angle;
  const turned = product([Math.cos(angle / 2), ...vector.map((v) => v * share)], rotation);
  const length = Math.hypot(...turned);
  rotation = turned.map((q) => q / length);
  ask();
}

function reset() {
  rotation = identity;
  ask();
}

async function ask() {
  wanted = true;
  if (busy) return;
  busy = true;
  try {
    let coming = request();
    while (coming) {
      const frame = await coming;
      coming = wanted ? request() : null; // the server renders while this frame is drawn
      draw(frame.bytes);
      count(frame);
    }
    say("");
  } catch (error) {
    say(error.message);
  } finally {
    busy = false;
  }
}

async function request() {
  wanted = false;
  const [asked, turned] = [performance.now(), rotation];
  const answer = await fetch(`frame?rotation=${turned.join()}&stops=${find("stops").value}`).catch(gone);
  if (!answer.ok) throw new Error(`The server refused: ${await answer.text().catch(gone)}`);
  const bytes = await answer.arrayBuffer().catch(gone);
  if (bytes.byteLength !== canvases.length * pictureBytes) {
    throw new Error("Another result is served here now: reload the page.");
  }
  return { bytes, turned, took: performance.now() - asked };
}

function gone() {
  throw new Error("The server has gone. Start torchbrdf live again, and open the address that it prints.");
}

function draw(bytes) {
  for (const canvas of canvases) {
    const part = new Uint8ClampedArray(bytes, Number(canvas.dataset.picture) * pictureBytes, pictureBytes);
    const context = canvas.getContext("2d", { alpha: false, willReadFrequently: true }); // kept in memory, not on a GPU
    context.putImageData(new ImageData(part, size, size), 0, 0);
  }
}

function count({ turned, took }) {
  const now = performance.now();
  frames += 1;
  arrivals = [...arrivals.filter((then) => now - then < 1000), now];
  const span = now - arrivals[0];
  find("frames").value = frames;
  find("took").value = `${Math.round(took)} ms`;
  if (arrivals.length > 2) find("rate").value = `${Math.round((1000 * (arrivals.length - 1)) / span)} frames a second`;
  const degrees = (2 * Math.acos(Math.min(1, Math.abs(turned[0]))) * 180) / Math.PI;
  find("angle").value = `${Math.round(degrees)}°`;
}

function say(text) {
  const notice = find("problem");
  if (notice.textContent !== text) notice.textContent = text;
  notice.hidden = text === "";
  document.body.classList.toggle("lost", text !== "");
}

// A server that goes away while nobody drags is noticed, too.
setInterval(async () => {
  if (busy || document.hidden) return;
  try {
    await fetch("/", { method: "HEAD" }).catch(gone);
    if (document.body.classList.contains("lost")) ask();
  } catch (error) {
    say(error.message);
  }
}, WATCH_MS);

for (const canvas of canvases) {
  let dragged = null; // pointer and where it was last

  // A turn by twice the angle between the normals: a reflection near the middle of the ball stays under the pointer.
  const vector = (x, y, about) => {
    const box = canvas.getBoundingClientRect();
    const radius = box.width / 2;
    const [dx, dy] = [(x - dragged.x) / radius, (y - dragged.y) / radius];
    if (!about) return [2 * dy, 2 * dx, 0];
    const [rx, ry] = [(dragged.x - box.left) / radius - 1, (dragged.y - box.top) / radius - 1];
    return [0, 0, (ry * dx - rx * dy) / Math.max(rx * rx + ry * ry, 0.1)];
  };

  canvas.addEventListener("pointerdown", (event) => {
    if (dragged || (event.button !== 0 && event.button !== 2)) return;
    canvas.setPointerCapture(event.pointerId);
    dragged = { id: event.pointerId, x: event.clientX, y: event.clientY };
    document.body.classList.add("dragging");
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!dragged || event.pointerId !== dragged.id) return;
    const about = event.shiftKey || (event.buttons & 2) !== 0;
    const turned = vector(event.clientX, event.clientY, about);
    Object.assign(dragged, { x: event.clientX, y: event.clientY });
    turn(turned);
  });
  const drop = (event) => {
    if (!dragged || event.pointerId !== dragged.id) return;
    dragged = null;
    document.body.classList.remove("dragging");
  };
  for (const kind of ["pointerup", "pointercancel", "lostpointercapture"]) canvas.addEventListener(kind, drop);
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("dblclick", reset);

  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const across = (angle) => (event.shiftKey ? [0, 0, -angle] : [0, angle, 0]);
    const turns = {
      ArrowRight: across(STEP),
      ArrowLeft: across(-STEP),
      ArrowDown: [STEP, 0, 0],
      ArrowUp: [-STEP, 0, 0],
    };
    if (event.key === "Home") reset();
    else if (event.key in turns) turn(turns[event.key]);
    else return;
    event.preventDefault();
  });
}

find("reset").addEventListener("click", reset);
find("stops").addEventListener("input", () => {
  const stops = Number(find("stops").value);
  find("exposure").value = `${stops < 0 ? "−" : "+"}${Math.abs(stops).toFixed(2)} stops`;
  ask();
});
ask();
