"use strict";
// The part of the start page about light: opens a relighting, shows its frames, says what is to change.
const stock = {
  "chalk": {kind: "lambert", albedo: [.85, .84, .8]},
  "clay": {kind: "lambert", albedo: [.5, .26, .17]},
  "blue plastic": {kind: "blinn_phong", diffuse: [.05, .13, .42], specular: [.08, .08, .08], exponent: 120},
  "glazed green": {kind: "ggx", diffuse: [.06, .28, .14], normal_reflectance: [.05, .05, .05], roughness: .2},
  "gold": {kind: "ggx", diffuse: [0, 0, 0], normal_reflectance: [1, .77, .34], roughness: .35},
  "steel": {kind: "ward", diffuse: [.02, .02, .02], specular: [.55, .56, .58], roughness: [.2, .2]},
};
const shelf = "from the shelf: ", captured = ["srf", "sbrdf_plus"], lightLost = 4004;
let relighting = null, lightSocket = null, scenery = null, about = "", awaited = null, drawn = 0, numbered = 0, dragging = null;

const degrees = angle => (((angle + 180) % 360) + 360) % 360 - 180;
const radians = angle => angle * Math.PI / 180;
const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
const fill = (select, groups) => select.replaceChildren(...groups.flatMap(([name, options]) => {
  const made = options.map(([value, text]) => new Option(text ?? value, value));
  if (!name || !made.length) return made;
  const group = document.createElement("optgroup");
  group.label = name; group.append(...made);
  return [group];
}));

async function listSubjects() {
  const [found, sessions] = await Promise.all([ask("/scenes"), ask("/sessions")]);
  const products = sessions.flatMap(one => one.products.filter(name => captured.includes(name))
    .map(product => [JSON.stringify({session: one.id, product}), `${product} of ${one.id}`]));
  fill(at("subject"), [["Scenes", found.scenes.map(scene => [JSON.stringify({scene}), scene])],
    ["Captured materials", found.environments.length ? products : []]]);
  fill(at("first-light"), [["", found.environments.map(name => [name])]]);
  const none = !at("subject").options.length;
  at("open-light").disabled = none;
  if (none) lightStatus("No scene lies in the folder of scenes (rig serve --scenes FOLDER), and no material was captured.");
  wantProduct();
}
function wantProduct() {
  const product = (at("subject").value || "").includes('"product"');
  at("shape-wanted").hidden = at("light-wanted").hidden = !product;
}
function lightStatus(text, isProblem = false) {
  at("light-status").textContent = text;
  at("light-status").className = isProblem ? "problem" : "";
}

async function openRelighting() {
  const wanted = JSON.parse(at("subject").value);
  if (wanted.product) Object.assign(wanted, {shape: at("shape").value, environment: at("first-light").value});
  if (relighting !== null) await closeRelighting();
  lightStatus("Reading the scene ...");
  const opened = await ask("/relightings", "POST", JSON.stringify(wanted));
  followRelighting(opened.id);
}
async function closeRelighting() {
  const number = relighting;
  leaveRelighting("Nothing is open.");
  await ask(`/relightings/${number}`, "DELETE");
}
function leaveRelighting(text) {
  relighting = null;
  if (lightSocket) lightSocket.close();
  lightSocket = null;
  at("studio").hidden = at("light-bar").hidden = true;
  at("close-light").disabled = true;
  lightStatus(text);
}
function followRelighting(number) {
  relighting = number;
  at("close-light").disabled = false;
  const mine = lightSocket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}${api}/relightings/${number}/frames`);
  mine.binaryType = "blob";
  mine.onmessage = event => { if (mine === lightSocket) typeof event.data === "string" ? hear(JSON.parse(event.data)) : attempt(() => showPicture(event.data)); };
  mine.onclose = event => {
    if (mine !== lightSocket) return;
    if (event.code === lightLost) { leaveRelighting("It was closed. Open it again."); return; }
    setTimeout(() => { if (mine === lightSocket) followRelighting(number); }, 1000);
  };
}
function tellLight(change, rough = false) {
  if (!lightSocket || lightSocket.readyState !== WebSocket.OPEN) return;
  if (at("light-status").className) lightStatus(about);  // what was wrong before
  lightSocket.send(JSON.stringify({...change, rough}));
}

function hear(message) {
  if (message.kind === "hello" || message.kind === "ready") meet(message);
  if (message.kind === "progress") showProgress(message);
  if (message.kind === "frame") awaited = message;
  if (message.kind === "problem") lightStatus(`${message.code}: ${message.detail}`, true);
  if (message.kind === "end") {
    const problem = at("light-status").className ? at("light-status").textContent : "";
    leaveRelighting(`Closed: ${message.reason}.`);
    if (problem) lightStatus(problem, true);
  }
}
function showProgress(message) {
  const bar = at("light-bar");
  bar.hidden = false;
  bar.max = message.total || 1; bar.value = message.done || 0;
  const left = message.eta_s === null ? "" : `, ${Math.ceil(message.eta_s)} s left of it`;
  lightStatus(message.stage ? `${message.stage}: ${message.done} of ${message.total}${left}. It is computed once and kept.` : "Waiting for its turn ...");
}
function meet(message) {
  at("light-bar").hidden = message.state !== "precomputing";
  at("studio").hidden = message.state !== "ready";
  if (message.state !== "ready") return;
  const body = at("body").value;
  fill(at("environment"), [["", message.environments.map(name => [name])]]);
  fill(at("body"), [["", message.bodies.map(name => [name])]]);
  at("body").value = message.bodies.includes(body) ? body : message.bodies.at(-1);
  fill(at("material"), [["Of the scene", message.materials.map(name => [name])], ["From the shelf", Object.keys(stock).map(name => [shelf + name, name])]]);
  about = [`${message.title}, drawn by ${message.standing.drawn_by}.`, ...message.doubts].join("\n");
  lightStatus(about);
  scenery = message.standing;
  showStanding();
}
async function showPicture(blob) {
  const message = awaited, number = ++numbered;
  const picture = await createImageBitmap(blob, {colorSpaceConversion: "none"});
  if (number < drawn || relighting === null) return;  // a later one was decoded before
  drawn = number;
  const view = at("view");
  if (!message.rough) { view.width = message.width_px; view.height = message.height_px; }
  view.getContext("2d").drawImage(picture, 0, 0, view.width, view.height);
  view.dataset.rough = message.rough;
  view.dataset.frames = number;
  if (!dragging && !message.rough) { scenery = message.standing; showStanding(); }
  const of = `${message.moving} vertices lit anew, ${message.cached} from known visibility, ${message.kept} as before`;
  at("frame-told").textContent = `${of}; ${(100 * message.visible_share).toFixed(0)} % of all are in the picture. Light ${message.lighting_ms.toFixed(0)} ms, drawing ${message.drawing_ms.toFixed(0)} ms.`;
}
function showStanding() {
  at("light-turn").value = Math.round(degrees(scenery.light_azimuth_deg));
  at("light-angle").textContent = `${at("light-turn").value}°`;
  at("environment").value = scenery.environment;
  showBody();
}
function showBody() {
  const body = scenery.bodies[at("body").value];
  at("body-turn").value = Math.round(degrees(body.turn_deg[2]));
  at("body-angle").textContent = `${at("body-turn").value}°`;
  at("material").value = body.material;
}

// The eye and the floor: where a ray through a place of the picture meets the plane that a body stands on.
function rayThrough(x, y) {
  const eye = scenery.eye, view = at("view"), up = radians(eye.elevation_deg), round = radians(eye.azimuth_deg);
  const out = [Math.cos(round) * Math.cos(up), Math.sin(round) * Math.cos(up), Math.sin(up)];
  const right = [-Math.sin(round), Math.cos(round), 0];
  const down = [Math.cos(round) * Math.sin(up), Math.sin(round) * Math.sin(up), -Math.cos(up)];
  const focal = .5 * Math.min(view.clientWidth, view.clientHeight) / Math.tan(radians(eye.field_of_view_deg) / 2);
  const across = (x - view.clientWidth / 2) / focal, below = (y - view.clientHeight / 2) / focal;
  return {from: eye.target_mm.map((value, k) => value + eye.distance_mm * out[k]),
          toward: out.map((value, k) => -value + across * right[k] + below * down[k])};
}
function onLevel(x, y, height_mm) {
  const {from, toward} = rayThrough(x, y);
  const steps = (height_mm - from[2]) / toward[2];
  return steps > 0 ? [from[0] + steps * toward[0], from[1] + steps * toward[1]] : null;
}

function turnEye(across_deg, up_deg, rough) {
  const eye = scenery.eye;
  eye.azimuth_deg = degrees(eye.azimuth_deg + across_deg);
  eye.elevation_deg = clamp(eye.elevation_deg + up_deg, 2, 88);
  tellLight({kind: "eye", azimuth_deg: eye.azimuth_deg, elevation_deg: eye.elevation_deg}, rough);
}
function approach(factor, rough) {
  scenery.eye.distance_mm = clamp(scenery.eye.distance_mm * factor, 50, 1e5);
  tellLight({kind: "eye", distance_mm: scenery.eye.distance_mm}, rough);
}
function moveBody(place, rough) {
  const name = at("body").value, body = scenery.bodies[name];
  body.place_mm = [clamp(place[0], -1e5, 1e5), clamp(place[1], -1e5, 1e5), body.place_mm[2]];
  tellLight({kind: "move", body: name, place_mm: body.place_mm}, rough);
}
at("view").onpointerdown = event => {
  if (!scenery || event.button !== 0) return;
  at("view").setPointerCapture(event.pointerId);
  at("view").focus();
  dragging = {x: event.offsetX, y: event.offsetY, moves: event.shiftKey};
  if (dragging.moves) {
    dragging.place = scenery.bodies[at("body").value].place_mm;
    dragging.start = onLevel(event.offsetX, event.offsetY, dragging.place[2]);
  }
};
function drag(event, rough) {
  if (dragging.moves) {
    const now = onLevel(event.offsetX, event.offsetY, dragging.place[2]);
    if (now && dragging.start) moveBody([0, 1].map(k => dragging.place[k] + now[k] - dragging.start[k]), rough);
    return;
  }
  turnEye(-.4 * (event.offsetX - dragging.x), .3 * (event.offsetY - dragging.y), rough);
  dragging.x = event.offsetX; dragging.y = event.offsetY;
}
at("view").onpointermove = event => { if (dragging) drag(event, true); };
at("view").onpointerup = event => { if (dragging) { drag(event, false); dragging = null; } };
at("view").onpointercancel = () => { dragging = null; };
at("view").addEventListener("wheel", event => { if (scenery) { event.preventDefault(); approach(Math.exp(clamp(event.deltaY, -200, 200) / 800), true); } }, {passive: false});
at("view").onkeydown = event => {
  const arrows = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1]}[event.key];
  if (!scenery || !(arrows || "+-".includes(event.key))) return;
  event.preventDefault();
  if (!arrows) { approach(event.key === "+" ? .9 : 1 / .9, false); return; }
  if (!event.shiftKey) { turnEye(5 * arrows[0], 4 * arrows[1], event.repeat); return; }
  const round = radians(scenery.eye.azimuth_deg), place = scenery.bodies[at("body").value].place_mm;
  const step = .01 * scenery.eye.distance_mm, [right, away] = arrows.map(value => step * value);
  moveBody([place[0] - Math.sin(round) * right - Math.cos(round) * away, place[1] + Math.cos(round) * right - Math.sin(round) * away], event.repeat);
};

// The controls. A slider tells all the way (rough), and once more where it comes to rest.
function turnLight(rough) {
  scenery.light_azimuth_deg = Number(at("light-turn").value);
  at("light-angle").textContent = `${at("light-turn").value}°`;
  tellLight({kind: "light", azimuth_deg: scenery.light_azimuth_deg}, rough);
}
function turnBody(rough) {
  const name = at("body").value, turn = scenery.bodies[name].turn_deg;
  turn[2] = Number(at("body-turn").value);
  at("body-angle").textContent = `${at("body-turn").value}°`;
  tellLight({kind: "move", body: name, turn_deg: turn}, rough);
}
at("light-turn").oninput = () => turnLight(true);
at("light-turn").onchange = () => turnLight(false);
at("body-turn").oninput = () => turnBody(true);
at("body-turn").onchange = () => turnBody(false);
at("environment").onchange = () => tellLight({kind: "environment", name: at("environment").value});
at("body").onchange = showBody;
at("material").onchange = () => {
  const name = at("material").value;
  tellLight({kind: "paint", body: at("body").value, name, material: stock[name.replace(shelf, "")] ?? name});
};
at("save-view").onclick = () => {
  const link = document.createElement("a");
  link.href = at("view").toDataURL("image/png"); link.download = "relit.png"; link.click();
};
at("subject").onchange = wantProduct;
at("open-light").onclick = () => attempt(openRelighting);
at("close-light").onclick = () => attempt(closeRelighting);
attempt(async () => {
  await listSubjects();
  const open = (await ask("/relightings")).filter(one => ["precomputing", "ready"].includes(one.state)).pop();
  if (open) followRelighting(open.id);  // a page that was loaded again goes on
});
