"use strict";
const about = JSON.parse(document.getElementById("about").textContent);
const element = (id) => document.getElementById(id);
const [canvas, left, right, stops, size, back] =
  ["canvas", "left", "right", "stops", "size", "back"].map(element);
const say = (text) => { element("values").textContent = text; };
const wanted = new URLSearchParams(location.hash.slice(1));

function bytes() {
  const text = element("data").textContent;
  element("data").textContent = "";
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text).buffer;
  const binary = atob(text), all = new Uint8Array(binary.length);
  for (let i = 0; i < all.length; i++) all[i] = binary.charCodeAt(i);
  return all.buffer;
}

// Half precision to a number, for the values of what is picked.
function half(bits) {
  const sign = bits & 0x8000 ? -1 : 1, exponent = bits >> 10 & 31, part = bits & 1023;
  if (exponent === 31) return part ? NaN : sign * Infinity;
  return sign * (exponent ? 2 ** (exponent - 15) * (1 + part / 1024) : 2 ** -24 * part);
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const add = (a, b, k = 1) => [0, 1, 2].map((i) => a[i] + k * b[i]);
const times = (a, k) => a.map((x) => x * k);
const length = (a) => Math.sqrt(dot(a, a));
const unit = (a) => times(a, 1 / (length(a) || 1));

const isCloud = about.triangles === null;
const center = add(about.low, about.size, 0.5);
const radius = Math.max(length(about.size) / 2, 1e-20);
const up = about.up, front = up[1] ? [0, 0, 1] : [0, -1, 0], side = cross(up, front);

// The camera: around a target, at a distance, towards angles; slope is the tangent of half its vertical angle.
let view;
function home() {
  view = { target: center, turn: 0.61, rise: 0.35, distance: 0, slope: 0.22, roll: null };
  view.distance = radius / view.slope * 1.05;
}
function fromCamera(camera) {
  home();
  const depth = Math.max(dot(add(camera.place, center, -1), camera.back), radius * 0.02);
  view.target = add(camera.place, camera.back, -depth);
  view.distance = depth;
  view.slope = camera.slope;
  view.rise = Math.asin(Math.min(1, Math.max(-1, dot(camera.back, up))));
  view.turn = Math.atan2(dot(camera.back, side), dot(camera.back, front));
}
function axes() {
  const level = add(times(front, Math.cos(view.turn)), side, Math.sin(view.turn));
  const towards = add(times(level, Math.cos(view.rise)), up, Math.sin(view.rise));
  const x = unit(cross(up, level));
  return { x, y: cross(towards, x), z: towards };
}

const gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
if (!gl) say("This page needs WebGL2.");

const VERTEX = `#version 300 es
precision highp float; precision highp int;
layout(location=0) in vec3 position; layout(location=1) in vec3 normal;
layout(location=2) in float radius; layout(location=3) in vec3 value;
uniform vec3 low, extent, eye, axisX, axisY, axisZ; uniform vec2 slope; uniform float pixels, grow, near, far;
uniform bool disks, sided, back;
out vec3 shown; out vec3 middle; out vec3 facing; out float reach; flat out int id;
void main() {
  vec3 p = low + position * extent - eye;
  middle = vec3(dot(p, axisX), dot(p, axisY), dot(p, axisZ));
  facing = vec3(dot(normal, axisX), dot(normal, axisY), dot(normal, axisZ));
  float depth = -middle.z;
  gl_Position = vec4(middle.xy / slope, (far + near) / (far - near) * depth - 2.0 * far * near / (far - near), depth);
  shown = value; id = gl_VertexID;
  if (disks) {
    reach = radius * grow;
    float wide = reach / slope.y / max(depth, near) * pixels;
    gl_PointSize = clamp(wide * 1.1, 1.5, 1024.0);
    if (wide < 2.0) reach = 1e20;
    if (sided && !back && dot(facing, -middle) <= 0.0) gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  }
}`;
const FRAGMENT = `#version 300 es
precision highp float; precision highp int;
in vec3 shown; in vec3 middle; in vec3 facing; in float reach; flat in int id;
uniform bool disks, sided, picking; uniform int kind; uniform float gain, factor; uniform vec2 range, slope;
uniform vec2 corner, view; uniform float near, far; uniform vec3 scale[9];
out vec4 color;
float encode(float x) {
  x = clamp(x, 0.0, 1.0);
  return x <= 0.0031308 ? 12.92 * x : 1.055 * pow(x, 1.0 / 2.4) - 0.055;
}
vec3 hue(float id) {
  float h = fract(id * 0.618034) * 6.0;
  vec3 k = mod(vec3(5.0, 3.0, 1.0) + h, 6.0);
  return 0.95 - 0.6 * clamp(min(k, 4.0 - k), 0.0, 1.0);
}
void main() {
  float depth = -middle.z;
  if (disks && reach < 1e19) {
    // the ray of this pixel against the disk's plane
    vec3 ray = vec3(((gl_FragCoord.xy - corner) / view * 2.0 - 1.0) * slope, -1.0);
    vec3 plane = sided ? facing : middle;
    float along = dot(plane, ray);
    if (along == 0.0) discard;
    float t = dot(plane, middle) / along;
    vec3 off = ray * t - middle;
    if (t <= near || dot(off, off) > reach * reach) discard;
    depth = t;
  }
  float z = (far + near) / (far - near) - 2.0 * far * near / (far - near) / depth;
  gl_FragDepth = 0.5 * z + 0.5;
  if (picking) {
    int k = id + 1;
    color = vec4(float(k & 255), float(k >> 8 & 255), float(k >> 16 & 255), float(k >> 24 & 255)) / 255.0;
    return;
  }
  vec3 v = shown * factor;
  if (shown.x < -60000.0) { color = vec4(0.41, 0.36, 0.41, 1.0); return; }
  if (kind == 0) color = vec4(encode(v.x * gain), encode(v.y * gain), encode(v.z * gain), 1.0);
  else if (kind == 1) {
    float at = clamp((v.x - range.x) / (range.y - range.x), 0.0, 1.0) * 8.0;
    int i = min(int(at), 7);
    color = vec4(mix(scale[i], scale[i + 1], at - float(i)), 1.0);
  } else if (kind == 2) color = vec4(0.5 * v + 0.5, 1.0);
  else color = vec4(hue(v.x), 1.0);
}`;

function program() {
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw Error(gl.getShaderInfoLog(shader));
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw Error(gl.getProgramInfoLog(made));
  return made;
}

const data = bytes();
const count = about.count;
const made = program();
gl.useProgram(made);
const at = new Proxy({}, { get: (seen, name) => seen[name] ??= gl.getUniformLocation(made, name) });

function buffer(kind, start, length) {
  const made = gl.createBuffer();
  gl.bindBuffer(kind, made);
  gl.bufferData(kind, new Uint8Array(data, start, length), gl.STATIC_DRAW);
  return made;
}
function attribute(place, made, [width, type, normalized, stride]) {
  gl.bindBuffer(gl.ARRAY_BUFFER, made);
  gl.enableVertexAttribArray(place);
  gl.vertexAttribPointer(place, width, type, normalized, stride, 0);
}
attribute(0, buffer(gl.ARRAY_BUFFER, about.positions, 8 * count), [3, gl.UNSIGNED_SHORT, true, 8]);
if (about.normals !== null) attribute(1, buffer(gl.ARRAY_BUFFER, about.normals, 4 * count), [3, gl.BYTE, true, 4]);
if (isCloud) attribute(2, buffer(gl.ARRAY_BUFFER, about.radii.at, 2 * count), [1, gl.HALF_FLOAT, false, 0]);
else buffer(gl.ELEMENT_ARRAY_BUFFER, about.triangles.at, 4 * about.triangles.count);

const channels = about.channels;
const channelOf = (name) => channels.find((channel) => channel.name === name);
function show(channel) {
  const wide = channel.kind === "id" ? 4 : 2;
  channel.buffer ??= buffer(gl.ARRAY_BUFFER, channel.at, wide * channel.components * count);
  attribute(3, channel.buffer, [channel.components, wide === 4 ? gl.FLOAT : gl.HALF_FLOAT, false, 0]);
  gl.uniform1i(at.kind, ["color", "scalar", "direction", "id"].indexOf(channel.kind));
  gl.uniform1f(at.factor, channel.scale);
  gl.uniform1f(at.gain, 2 ** (channel.stops + Number(stops.value)));
  gl.uniform2f(at.range, channel.range[0], channel.range[1]);
}

for (const [choice, none] of [[left, false], [right, true]]) {
  if (none) choice.append(new Option("nothing", ""));
  for (const channel of channels) choice.append(new Option(channel.name, channel.name));
}
left.value = wanted.get("left") ?? about.left;
right.value = wanted.get("right") ?? about.right ?? "";
stops.value = wanted.get("stops") ?? 0;
back.checked = wanted.has("back");
for (const input of [size, back]) input.parentElement.hidden = !isCloud;
element("counts").textContent =
  isCloud ? `${count} points` : `${about.triangles.count / 3} triangles, ${count} vertices`;

function halves() {
  const split = right.value !== "";
  const wide = split ? Math.floor(canvas.width / 2) : canvas.width;
  const all = [[left.value, 0]];
  if (split) all.push([right.value, canvas.width - wide]);
  return { wide, all };
}

function draw(picking = false) {
  const { x, y, z } = axes();
  const eye = add(view.target, z, view.distance);
  const { wide, all } = halves();
  // narrower than high: the horizontal angle is kept
  const aspect = wide / canvas.height, high = view.slope * Math.max(1, 1 / aspect);
  gl.enable(gl.DEPTH_TEST);
  gl.enable(gl.SCISSOR_TEST);
  for (const [name, place] of [["eye", eye], ["axisX", x], ["axisY", y], ["axisZ", z]]) gl.uniform3fv(at[name], place);
  gl.uniform3fv(at.low, about.low);
  gl.uniform3fv(at.extent, about.size);
  gl.uniform2f(at.slope, high * aspect, high);
  gl.uniform2f(at.view, wide, canvas.height);
  gl.uniform1f(at.pixels, canvas.height);
  gl.uniform1f(at.grow, Number(size.value) * (isCloud ? about.radii.scale : 1));
  const far = length(add(eye, center, -1)) + 1.01 * radius;
  gl.uniform1f(at.near, Math.max(far * 1e-5, far - 2.1 * radius));
  gl.uniform1f(at.far, far);
  gl.uniform1i(at.disks, isCloud);
  gl.uniform1i(at.sided, about.normals !== null);
  gl.uniform1i(at.back, back.checked);
  gl.uniform1i(at.picking, picking);
  gl.uniform3fv(at["scale"], about.scale.flat());
  for (const [name, corner] of all) {
    gl.viewport(corner, 0, wide, canvas.height);
    gl.scissor(corner, 0, wide, canvas.height);
    gl.clearColor(...(picking ? [0, 0, 0, 0] : [0.149, 0.149, 0.165, 1]));
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniform2f(at.corner, corner, 0);
    const channel = channelOf(name);
    if (channel) show(channel);
    if (isCloud) gl.drawArrays(gl.POINTS, 0, count);
    else gl.drawElements(gl.TRIANGLES, about.triangles.count, gl.UNSIGNED_INT, 0);
  }
  return { eye, x, y, z, high, aspect, wide, all };
}

function scales() {
  const text = (x) => Number(x.toPrecision(3)).toString();
  const all = halves().all.map(([name]) => channelOf(name)).filter(Boolean);
  const box = (channel) => {
    const made = document.createElement("div");
    made.className = "scale";
    made.append(channel.name);
    const shift = channel.stops + Number(stops.value);
    if (channel.kind === "color" && shift) made.append(` ${shift > 0 ? "+" : ""}${shift.toFixed(1)} stops`);
    if (channel.kind === "scalar") {
      const bar = document.createElement("div"), ends = document.createElement("span");
      bar.style.background = `linear-gradient(90deg,${about.scale.map((c) => `rgb(${times(c, 255)})`)})`;
      const [a, b] = channel.range;
      for (const x of [a, (a + b) / 2, b]) ends.append(Object.assign(document.createElement("b"), { textContent: text(x) }));
      made.append(bar, ends);
    }
    return made;
  };
  element("scales").replaceChildren(...all.map(box));
}

let asked = false;
function redrawNow() {
  asked = false;
  draw();
  scales();
}
function redraw() {
  if (asked) return;
  asked = true;
  requestAnimationFrame(redrawNow);
}

// What is drawn at a pixel (from the lower left): the id of the vertex or surfel; -1 for nothing.
function idAt(x, y) {
  const target = gl.createFramebuffer(), [color, depth] = [gl.createRenderbuffer(), gl.createRenderbuffer()];
  gl.bindFramebuffer(gl.FRAMEBUFFER, target);
  for (const [made, format, place] of [[color, gl.RGBA8, gl.COLOR_ATTACHMENT0], [depth, gl.DEPTH_COMPONENT24, gl.DEPTH_ATTACHMENT]]) {
    gl.bindRenderbuffer(gl.RENDERBUFFER, made);
    gl.renderbufferStorage(gl.RENDERBUFFER, format, canvas.width, canvas.height);
    gl.framebufferRenderbuffer(gl.FRAMEBUFFER, place, gl.RENDERBUFFER, made);
  }
  const drawn = draw(true), pixel = new Uint8Array(4);
  gl.readPixels(x, y, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  gl.deleteFramebuffer(target);
  gl.deleteRenderbuffer(color);
  gl.deleteRenderbuffer(depth);
  return [(pixel[0] | pixel[1] << 8 | pixel[2] << 16 | pixel[3] << 24) - 1, drawn];
}

const positions = new Uint16Array(data, about.positions, 4 * count);
const place = (i) => [0, 1, 2].map((k) => about.low[k] + positions[4 * i + k] / 65535 * about.size[k]);

// The corner nearest to the pixel of the triangles that end with vertex `last`.
function nearest(last, x, y, drawn) {
  const indices = new Uint32Array(data, about.triangles.at, about.triangles.count);
  const { eye, high, aspect, wide, all } = drawn;
  const corner = all[all.length - 1][1] > 0 && x >= all[all.length - 1][1] ? all[all.length - 1][1] : 0;
  const off = (i) => {
    const p = add(place(i), eye, -1), depth = -dot(p, drawn.z);
    const u = (dot(p, drawn.x) / depth / (high * aspect) * 0.5 + 0.5) * wide + corner - x;
    const v = (dot(p, drawn.y) / depth / high * 0.5 + 0.5) * canvas.height - y;
    return u * u + v * v;
  };
  let best = last;
  for (let t = 2; t < indices.length; t += 3) {
    if (indices[t] !== last) continue;
    for (let k = 0; k < 3; k++) if (off(indices[t - k]) < off(best)) best = indices[t - k];
  }
  return best;
}

function valueOf(channel, i) {
  const { components, scale, kind } = channel;
  const of = (k) => kind === "id"
    ? new Float32Array(data, channel.at, count)[i]
    : scale * half(new Uint16Array(data, channel.at, components * count)[components * i + k]);
  const values = Array.from({ length: components }, (_, k) => of(k));
  return values[0] < -60000 * scale && kind !== "id" ? null : values;
}

// `x`, `y` in pixels of the page from the upper left.
function pick(x, y) {
  const ratio = canvas.width / canvas.clientWidth;
  const [px, py] = [Math.floor(x * ratio), canvas.height - 1 - Math.floor(y * ratio)];
  let [id, drawn] = idAt(px, py);
  draw();
  if (id < 0) { say("nothing there"); return; }
  if (!isCloud) id = nearest(id, px, py, drawn);
  const text = (x) => Number(x.toPrecision(4)).toString();
  let owner = 0;
  for (const [first, which] of about.owners) { if (first <= id) owner = which; else break; }
  const rows = [[isCloud ? "surfel" : "vertex", id], ["prim", about.ownerPaths[owner]],
    ["P", add(place(id), about.origin).map(text).join("  ")]];
  if (isCloud) rows.push(["radius", text(about.radii.scale * half(new Uint16Array(data, about.radii.at, count)[id]))]);
  for (const channel of channels) rows.push([channel.name, valueOf(channel, id)?.map(text).join("  ") ?? "none"]);
  say(rows.filter((row) => row[1] !== "").map(([name, value]) => name.padEnd(30) + value).join("\n"));
}

function resize() {
  const ratio = window.devicePixelRatio || 1;
  canvas.width = Math.max(1, Math.round(canvas.clientWidth * ratio));
  canvas.height = Math.max(1, Math.round(canvas.clientHeight * ratio));
  redraw();
}

let grip = null;
canvas.addEventListener("pointerdown", (event) => {
  canvas.setPointerCapture(event.pointerId);
  grip = { x: event.clientX, y: event.clientY, moved: 0, pan: event.button !== 0 || event.shiftKey };
});
canvas.addEventListener("pointermove", (event) => {
  if (!grip) return;
  const [dx, dy] = [event.clientX - grip.x, event.clientY - grip.y];
  grip.moved += Math.abs(dx) + Math.abs(dy);
  [grip.x, grip.y] = [event.clientX, event.clientY];
  if (grip.pan) {
    const { x, y } = axes(), k = 2 * view.slope * view.distance / canvas.clientHeight;
    view.target = add(add(view.target, x, -dx * k), y, dy * k);
  } else {
    view.turn -= dx * 0.008;
    view.rise = Math.min(1.57, Math.max(-1.57, view.rise + dy * 0.008));
  }
  redraw();
});
canvas.addEventListener("pointerup", (event) => {
  if (grip && grip.moved < 4) pick(event.clientX, event.clientY);
  grip = null;
});
canvas.addEventListener("contextmenu", (event) => event.preventDefault());
canvas.addEventListener("wheel", (event) => {
  event.preventDefault();
  view.distance *= Math.exp(event.deltaY * 0.0012);
  redraw();
}, { passive: false });
for (const input of [left, right, stops, size, back]) input.addEventListener("input", redraw);
element("home").addEventListener("click", () => { home(); redraw(); });
window.addEventListener("resize", resize);

home();
if (about.camera) fromCamera(about.camera);
resize();
// not with the next frame: whoever waits until the page has loaded sees all of it
redrawNow();
if (wanted.has("pick")) pick(...wanted.get("pick").split(",").map(Number));
