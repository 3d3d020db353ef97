"use strict";
// One WebGL context draws sphere after sphere; each is copied to a canvas of its own, over the picture rendered before.
// Where WebGL fails those pictures stay.

const STEP = Math.PI / 36; // a key's turn, 5 degrees

const find = (id) => document.getElementById(id);
const canvases = Array.from(document.querySelectorAll("canvas"));
const size = canvases[0].width;
const settings = find("turn").dataset;
const start = settings.light.split(",").map(Number);

// The sphere is orthographic, the camera at +Z. The half vector, theta_d and w_i - w_o are the same for all pixels and
// come from the processor, in double precision.
const VERTEX = `#version 300 es
void main() { // one triangle over the whole picture
  gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0);
}`;
const FRAGMENT = `#version 300 es
precision highp float;
precision highp sampler3D;
uniform sampler3D table, first;
uniform float scale, firstScale, gain, side, thetaD, range;
uniform vec3 light, halfway, apart, brightness, colours[5];
uniform bool signedDifference;
out vec4 colour;
const float PI = 3.141592653589793;
const int SUB = 4; // points along a side of a pixel

vec3 place(vec3 n) { // in the texture: theta_h warped as MERL's rows, theta_d, phi_d
  vec3 across = cross(n, halfway);
  float thetaH = atan(length(across), dot(n, halfway));
  vec2 d = vec2(-dot(apart, n), dot(across, apart));
  float phiD = dot(d, d) > 0.0 ? atan(d.y, d.x) : 0.0;
  return vec3(sqrt(thetaH * (2.0 / PI)), thetaD * (2.0 / PI), phiD / PI);
}

vec3 between(float t) {
  float at = clamp(t, 0.0, 1.0) * 4.0;
  int i = min(int(at), 3);
  return mix(colours[i], colours[i + 1], at - float(i));
}

void main() {
  vec3 sum = vec3(0.0), firstSum = vec3(0.0);
  for (int k = 0; k < SUB * SUB; k++) {
    vec2 inside = (vec2(k % SUB, k / SUB) + 0.5) / float(SUB);
    vec2 p = (floor(gl_FragCoord.xy) + inside) * (2.0 / side) - 1.0;
    p *= min(1.0, 0.999 * inversesqrt(dot(p, p) + 1e-12)); // what the silhouette cuts continues its neighbours
    vec3 n = vec3(p, sqrt(1.0 - dot(p, p)));
    float cosine = dot(n, light);
    if (cosine <= 0.0) continue;
    vec3 at = place(n);
    sum += cosine * textureLod(table, at, 0.0).rgb; // texture() would need derivatives, and a branch has none
    if (signedDifference) firstSum += cosine * textureLod(first, at, 0.0).rgb;
  }
  vec3 radiance = sum * (scale * PI / float(SUB * SUB)); // the light's irradiance is pi
  if (signedDifference) {
    vec3 more = radiance - firstSum * (firstScale * PI / float(SUB * SUB));
    colour = vec4(between(0.5 + 0.5 * dot(more, brightness) * gain / range), 1.0);
  } else {
    colour = vec4(pow(clamp(radiance * gain, 0.0, 1.0), vec3(1.0 / 2.2)), 1.0);
  }
}`;

let gl = null;
let uniforms = null;
let textures = [];
let light = start; // unit vector towards the light: +X is right, +Y up, +Z towards the viewer
let waiting = false;

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const plus = (a, b, s) => a.map((v, i) => v + s * b[i]);
const length = (a) => Math.hypot(...a);
const unit = (a) => a.map((v) => v / length(a));

function shader(kind, source) {
  const made = gl.createShader(kind);
  gl.shaderSource(made, source);
  gl.compileShader(made);
  return made;
}

// What stays the same for all frames; again where the browser took the graphics processor away and gave it back.
function prepare() {
  const program = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    gl.attachShader(program, shader(kind, source));
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program) || "no program");
  gl.useProgram(program);
  uniforms = (name) => gl.getUniformLocation(program, name);
  textures = canvases.map((_, i) => upload(find(`table-${i}`).textContent));
  gl.uniform1i(uniforms("first"), 1);
  gl.uniform1f(uniforms("firstScale"), Number(canvases[0].dataset.scale));
  gl.uniform1f(uniforms("side"), size);
  gl.uniform1f(uniforms("range"), Number(settings.range));
  gl.uniform3fv(uniforms("brightness"), settings.brightness.split(",").map(Number));
  gl.uniform3fv(uniforms("colours"), settings.colours.split(",").map(Number));
  gl.activeTexture(gl.TEXTURE1);
  gl.bindTexture(gl.TEXTURE_3D, textures[0]);
  gl.activeTexture(gl.TEXTURE0);
  gl.viewport(0, 0, size, size);
}

function upload(text) {
  const bytes = Uint8Array.from(atob(text.trim()), (c) => c.charCodeAt(0));
  const [width, height, depth] = settings.texture.split(",").map(Number);
  const texture = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_3D, texture);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 2);
  const values = new Uint16Array(bytes.buffer);
  gl.texImage3D(gl.TEXTURE_3D, 0, gl.RGB16F, width, height, depth, 0, gl.RGB, gl.HALF_FLOAT, values);
  const wrap = { [gl.TEXTURE_WRAP_S]: gl.CLAMP_TO_EDGE, [gl.TEXTURE_WRAP_T]: gl.CLAMP_TO_EDGE };
  const filter = { [gl.TEXTURE_MIN_FILTER]: gl.LINEAR, [gl.TEXTURE_MAG_FILTER]: gl.LINEAR };
  for (const [name, value] of Object.entries({ ...wrap, [gl.TEXTURE_WRAP_R]: gl.REPEAT, ...filter })) {
    gl.texParameteri(gl.TEXTURE_3D, Number(name), value);
  }
  return texture;
}

function ask() {
  if (waiting || gl === null) return;
  waiting = true;
  requestAnimationFrame(() => {
    waiting = false;
    if (!gl.isContextLost()) draw();
  });
}

function draw() {
  const view = [0, 0, 1];
  const [together, apart] = [plus(light, view, 1), plus(light, view, -1)];
  const halfway = length(together) > 1e-9 ? unit(together) : [1, 0, 0]; // light from behind reaches no pixel
  gl.uniform3fv(uniforms("light"), light);
  gl.uniform3fv(uniforms("halfway"), halfway);
  gl.uniform3fv(uniforms("apart"), apart);
  gl.uniform1f(uniforms("thetaD"), Math.atan2(length(apart), length(together)));
  gl.uniform1f(uniforms("gain"), Number(settings.gain) * 2 ** Number(find("stops").value));
  const difference = find("difference").checked;
  canvases.forEach((canvas, i) => {
    gl.uniform1i(uniforms("signedDifference"), difference && i > 0 ? 1 : 0);
    gl.uniform1f(uniforms("scale"), Number(canvas.dataset.scale));
    gl.bindTexture(gl.TEXTURE_3D, textures[i]);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    canvas.getContext("2d", { alpha: false }).drawImage(gl.canvas, 0, 0);
  });
  const round = (angle) => `${Math.round((angle * 180) / Math.PI)}°`;
  find("angle").value = round(Math.acos(Math.max(-1, Math.min(1, light[2]))));
  find("around").value = Math.hypot(light[0], light[1]) < 1e-6 ? "–" : round(clock(light));
  find("frames").value = Number(find("frames").value) + 1;
}

// Clockwise from the top of the picture, 0 to 2 pi.
function clock([x, y]) {
  const angle = Math.atan2(x, y);
  return angle < -1e-9 ? angle + 2 * Math.PI : Math.max(angle, 0);
}

function say(text) {
  find("problem").textContent = text;
  find("problem").hidden = text === "";
}

function shine(vector) {
  light = unit(vector);
  ask();
}

// Turns the light about an axis.
function turn(axis, angle) {
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  const [[ax, ay, az], [x, y, z]] = [axis, light];
  const crossed = [ay * z - az * y, az * x - ax * z, ax * y - ay * x];
  shine(light.map((v, i) => v * c + crossed[i] * s + axis[i] * dot(axis, light) * (1 - c)));
}

function listenTo(canvas) {
  let dragged = null; // a pointer

  // The highlight goes where the pointer is: the normal there halves light and view.
  const follow = (event) => {
    const box = canvas.getBoundingClientRect();
    let [x, y] = [(2 * (event.clientX - box.left)) / box.width - 1, 1 - (2 * (event.clientY - box.top)) / box.height];
    const r = Math.hypot(x, y);
    if (r > 0.999) [x, y] = [(0.999 * x) / r, (0.999 * y) / r];
    const z = Math.sqrt(1 - x * x - y * y);
    shine([2 * z * x, 2 * z * y, 2 * z * z - 1]);
  };
  const drop = (event) => {
    if (event.pointerId !== dragged) return;
    dragged = null;
    document.body.classList.remove("dragging");
  };

  canvas.addEventListener("pointerdown", (event) => {
    if (dragged !== null || event.button !== 0) return;
    canvas.setPointerCapture(event.pointerId);
    dragged = event.pointerId;
    document.body.classList.add("dragging");
    follow(event);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (event.pointerId === dragged) follow(event);
  });
  for (const kind of ["pointerup", "pointercancel", "lostpointercapture"]) canvas.addEventListener(kind, drop);
  canvas.addEventListener("dblclick", () => shine(start));

  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const [right, down] = event.shiftKey ? [[0, 0, -1], [0, 0, -1]] : [[0, 1, 0], [1, 0, 0]];
    const turns = {
      ArrowRight: [right, STEP],
      ArrowLeft: [right, -STEP],
      ArrowDown: [down, STEP],
      ArrowUp: [down, -STEP],
    };
    if (event.key === "Home") shine(start);
    else if (event.key in turns) turn(...turns[event.key]);
    else return;
    event.preventDefault();
  });
}

function begin() {
  const drawn = document.createElement("canvas");
  drawn.width = drawn.height = size;
  gl = drawn.getContext("webgl2", { alpha: false, antialias: false, depth: false });
  if (gl === null) throw new Error("this browser has no WebGL 2");
  drawn.addEventListener("webglcontextlost", (event) => {
    event.preventDefault();
    say("The browser took the graphics processor away from this page; reload the page if it does not come back.");
  });
  drawn.addEventListener("webglcontextrestored", () => {
    prepare();
    say("");
    ask();
  });
  prepare();
  canvases.forEach(listenTo);
  draw();
  for (const canvas of canvases) {
    canvas.hidden = false;
    canvas.previousElementSibling.hidden = true;
  }
  find("controls").hidden = false;
  find("reset").addEventListener("click", () => shine(start));
  find("stops").addEventListener("input", () => {
    const stops = Number(find("stops").value);
    find("exposure").value = `${stops < 0 ? "−" : "+"}${Math.abs(stops).toFixed(2)} stops`;
    ask();
  });
  for (const id of ["radiance", "difference"]) {
    find(id).addEventListener("change", () => {
      find("scale").hidden = !find("difference").checked;
      ask();
    });
  }
}

try {
  begin();
} catch (error) {
  say(`The light cannot be turned here: ${error.message}. The spheres below are lit as the text says.`);
}
