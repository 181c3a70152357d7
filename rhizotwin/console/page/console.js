// Page of the console: polls the state, displays it, and sends the user's actions.

import { Sketch } from "/sketch.js";

const WAIT_S = 20;
const RETRY_MS = 2000;
const secret = document.querySelector('meta[name="secret"]').content;
const client = stored(sessionStorage, "client", () => Array.from(crypto.getRandomValues(new Uint8Array(16)), (byte) => byte.toString(16).padStart(2, "0")).join(""));
const by = (id) => document.getElementById(id);
const sketch = new Sketch(by("sketch"));
let state = null;
const shown = { picture: 0, sketch: -1, messages: 0, plants: "" };

function stored(storage, key, make) {
  const found = storage.getItem(`rhizotwin-${key}`) ?? make();
  storage.setItem(`rhizotwin-${key}`, found);
  return found;
}

// Create an element with the given properties and children.
function make(tag, properties, ...inside) {
  const element = Object.assign(document.createElement(tag), properties);
  element.append(...inside.filter((one) => one !== null));
  return element;
}

async function send(method, path, body) {
  const headers = { "X-Rhizotwin-Client": client, "X-Rhizotwin-Token": secret };
  if (body !== undefined) headers["Content-Type"] = "application/json";
  const response = await fetch(path, { method, headers, body: body === undefined ? undefined : JSON.stringify(body) });
  if (response.ok) return response;
  let text = `${response.status} ${response.statusText}`;
  try {
    const detail = (await response.json()).detail;
    text = typeof detail === "string" ? detail : detail.map((one) => `${one.loc.at(-1)}: ${one.msg}`).join("; ");
  } catch { /* no JSON */ }
  throw new Error(text);
}

// Send an action of the user, and show the error message if it fails.
async function act(method, path, body) {
  warn("");
  try {
    return await send(method, path, body);
  } catch (error) {
    warn(error.message);
    return null;
  }
}

function warn(text) {
  by("alert").textContent = text;
  by("alert").hidden = text === "";
}

// --- display of the state

function show(next) {
  state = next;
  const own = state.controls.own;
  const running = state.scan !== null && state.scan.state !== "ended";
  by("rig").textContent = `${state.rig.name}${state.rig.emulated && state.rig.name !== "twin" ? " (emulated)" : state.rig.emulated ? ": emulated rig" : ""}, scene ${state.rig.scene}`;
  by("activity").textContent = state.activity || "idle";
  by("activity").className = `pill ${state.activity ? "busy" : ""}`;
  showControl();
  showScan(running);
  showQuestion();
  showSchedule();
  showPlants();
  showPicture();
  showSketch();
  by("devices").replaceChildren(...state.devices.map((one) => row(one.state, one.name, one.text)));
  showScans();
  showMessages();
  showProblems();
  by("arm").hidden = !state.rig.arm;
  by("live").setAttribute("aria-pressed", state.live);
  for (const one of document.querySelectorAll("main button, main input, main select")) {
    if (one.closest("#question") || one.closest("#schedule") || one.closest("table")) continue;
    one.disabled = !own || state.activity !== "";
  }
  by("pause").disabled = by("continue").disabled = !own;
  by("stop").disabled = !running || state.scan.state === "stopping";
  by("schedule-start").disabled = !own || state.activity !== "";
  by("schedule-stop").disabled = !own || state.schedule?.state !== "running";
  for (const one of document.querySelectorAll("#question button, #question input")) one.disabled = !own;
}

function row(kind, name, text, soft = "") {
  return make("div", { className: "state" }, make("span", { className: `dot ${kind}`, title: kind }), make("b", {}, name), make("span", { className: kind === "wrong" ? "wrong" : "" }, text, soft ? make("br") : "", soft ? make("span", { className: "soft" }, soft) : ""));
}

function showControl() {
  const { name, since, own, idle_s: idle } = state.controls;
  const away = idle > 60 ? `, last connected ${Math.round(idle / 60)} min ago` : "";
  by("holder").textContent = own ? `You (${name}) control the rig` : name === null ? "No one controls the rig" : `${name} has controlled the rig since ${since}${away}`;
  by("holder").className = own ? "own" : "";
  by("take").textContent = name === null ? "Take control" : "Take over";
  by("take").hidden = by("name").hidden = own;
  by("give").hidden = !own;
}

function showScan(running) {
  const scan = state.scan;
  by("running").hidden = scan === null;
  by("start").hidden = running;
  by("plan").textContent = `${state.rig.views} pictures`;
  if (scan === null) return;
  by("scan-name").textContent = scan.name;
  by("scan-subject").textContent = scan.subject;
  by("scan-bar").max = Math.max(scan.total, 1);
  by("scan-bar").value = scan.done;
  const left = scan.left_s === null ? "" : `, about ${duration(scan.left_s)} left`;
  const words = { running: `running${left}`, paused: "paused with lights, motor and arm switched on", stopping: "stopping: lights are switched off, and the arm is parked; the pictures are kept", ended: scan.done === scan.total && scan.total ? "complete" : scan.done ? "ended; finish the scan in the list of scans" : "ended before the first picture" };
  by("scan-state").textContent = scan.total === 0 && running ? "not started yet" : `${scan.done} of ${scan.total} pictures, ${words[scan.state]}`;
  by("scan-error").textContent = scan.error;
  by("scan-error").hidden = scan.error === "";
  by("pause").hidden = scan.state !== "running";
  by("continue").hidden = scan.state !== "paused";
  by("stop").hidden = !running;
}

function showQuestion() {
  if (by("question").dataset.number !== `${state.question_number}`) by("answer").value = "";
  by("question").dataset.number = state.question_number;
  by("question").hidden = state.question === "";
  by("question-text").textContent = state.question;
}

function showSchedule() {
  const schedule = state.schedule;
  by("schedule").hidden = schedule === null;
  if (schedule === null) return;
  by("schedule-name").textContent = schedule.name;
  by("schedule-bar").max = Math.max(schedule.planned, 1);
  by("schedule-bar").value = schedule.scanned + schedule.missed_count;
  const words = { running: "running", stopping: "ends after this scan", stopped: "not running" };
  by("schedule-state").textContent = `${schedule.scanned} of ${schedule.planned} scans finished, ${schedule.missed_count} missed; ${words[schedule.state]}`;
  by("growth").hidden = !schedule.growth;
  const group = (title, visits) => (visits.length ? [make("tr", {}, make("th", { colSpan: 3 }, title)), ...visits.map((one) => make("tr", {}, make("td", {}, one.due), make("td", {}, one.plant), make("td", { className: one.state === "missed" ? "wrong" : "" }, one.state + (one.note ? `: ${one.note}` : ""))))] : []);
  by("visits").replaceChildren(...group("Today", schedule.today), ...group("Next", schedule.next), ...group("Missed", schedule.missed));
}

// Set the title of a cell, which is displayed before the cell on narrow screens.
function labelled(cell, title) {
  cell.dataset.title = title;
  return cell;
}

function showPlants() {
  const text = JSON.stringify(state.plants);
  if (text === shown.plants) return;
  shown.plants = text;
  by("known-plants").replaceChildren(...state.plants.map((one) => make("option", { value: one.name })));
  const titles = Array.from(by("plants").tHead.rows[0].cells, (cell) => cell.textContent);
  const rows = state.plants.map((one) => make("tr", {}, ...[one.name, one.treatment, one.day ?? "", one.scans, one.last, one.tag].map((cell, k) => labelled(make("td", {}, `${cell}`), titles[k]))));
  if (rows.length === 0) rows.push(make("tr", {}, make("td", { colSpan: 6, className: "soft" }, "No plants yet; the first scan of a plant adds the plant")));
  by("plants").tBodies[0].replaceChildren(...rows);
}

function duration(seconds) {
  return seconds < 90 ? `${seconds} s` : `${Math.round(seconds / 60)} min`;
}

function showPicture() {
  const picture = state.picture;
  by("picture").hidden = picture === null;
  by("no-picture").hidden = picture !== null;
  if (picture === null || picture.number === shown.picture) return;
  shown.picture = picture.number;
  by("picture").src = `/api/picture.jpg?number=${picture.number}`;
  by("picture-title").textContent = picture.title;
  by("meters").replaceChildren(...picture.meters.map((one) => row(one.state, one.name, one.value, one.limits)));
}

async function showSketch() {
  const { number, radius_mm: radius, height_mm: height } = state.sketch;
  if (number === shown.sketch) return;
  shown.sketch = number;
  try {
    const response = await send("GET", "/api/sketch");
    sketch.set(new Float32Array(await response.arrayBuffer()), radius, height);
  } catch {
    shown.sketch = null; // drawn with the next state; a lost connection is shown by `follow`
  }
}

function showScans() {
  const own = state.controls.own;
  const jobs = Object.fromEntries(state.queue.map((job) => [job.scan, job]));
  const rows = state.scans.map((scan) => {
    const job = jobs[scan.name];
    const done = scan.error || `${scan.pictures} of ${scan.planned}${scan.running ? ", running" : scan.complete ? (scan.sketch ? ", sketches" : "") : ", interrupted"}`;
    const buttons = make("span", { className: "buttons" });
    const add = (text, action, enabled) => buttons.append(make("button", { type: "button", onclick: action, disabled: !own || !enabled }, text));
    const name = encodeURIComponent(scan.name);
    if (!scan.complete && !scan.running && !scan.error) add("Finish scan", () => act("POST", `/api/scans/${name}/finish`, { reconstruct: by("reconstruct").checked }), state.activity === "");
    if (scan.complete && !scan.sketch && !scan.running && !["waiting", "running"].includes(scan.queue)) add("Reconstruct", () => act("POST", "/api/queue", { scan: scan.name }), true);
    if (["waiting", "running"].includes(scan.queue)) add("Cancel", () => act("DELETE", `/api/queue/${name}`), true);
    if (scan.result) buttons.prepend(make("a", { href: `/results/${name}/report.html`, target: "_blank", rel: "noopener" }, "Report"));
    return make("tr", {}, make("td", {}, scan.name), make("td", {}, scan.subject), make("td", {}, done), make("td", {}, result(scan, job)), make("td", { className: "actions" }, buttons));
  });
  if (rows.length === 0) rows.push(make("tr", {}, make("td", { colSpan: 5, className: "soft" }, "No scans yet")));
  by("scans").tBodies[0].replaceChildren(...rows);
}

function result(scan, job) {
  if (job?.state === "waiting") return `waiting for reconstruction${job.error && `: ${job.error}`}`;
  if (job?.state === "running") return make("span", {}, `reconstructing: ${job.stage}`, make("progress", { max: 1, value: job.fraction }));
  if (job?.state === "failed") return make("span", { className: "wrong" }, `reconstruction failed: ${job.error}`);
  return scan.result === null ? "" : scan.result.volume;
}

function showProblems() {
  by("problems").hidden = state.problems.length === 0;
  by("problems").replaceChildren(...state.problems.map((text) => make("p", {}, text)));
}

function showMessages() {
  const latest = state.messages.length ? state.messages[0].number : 0;
  if (latest === shown.messages) return;
  shown.messages = latest;
  by("messages").replaceChildren(...state.messages.map((one) => make("li", { className: one.kind }, make("time", {}, one.time), one.text)));
}

// --- actions of the user

by("name").value = localStorage.getItem("rhizotwin-name") ?? "";
by("control").addEventListener("submit", (event) => {
  event.preventDefault();
  localStorage.setItem("rhizotwin-name", by("name").value);
  act("POST", "/api/control", { name: by("name").value });
});
by("give").addEventListener("click", () => act("DELETE", "/api/control"));
by("check").addEventListener("click", () => act("POST", "/api/devices/check"));
by("release").addEventListener("click", () => act("POST", "/api/devices/release"));
by("live").addEventListener("click", () => act("POST", "/api/live", { on: !state.live }));
by("shot").addEventListener("click", () => act("POST", "/api/picture"));
by("pause").addEventListener("click", () => act("POST", "/api/scan/pause"));
by("continue").addEventListener("click", () => act("POST", "/api/scan/continue"));
by("stop").addEventListener("click", () => act("POST", "/api/scan/stop"));
by("schedule-start").addEventListener("click", () => act("POST", "/api/schedule/start"));
by("schedule-stop").addEventListener("click", () => act("POST", "/api/schedule/stop"));
const command = (line) => act("POST", "/api/command", { line });
for (const button of document.querySelectorAll("button[data-line]")) button.addEventListener("click", () => command(button.dataset.line));
for (const button of document.querySelectorAll("button[data-joint]")) button.addEventListener("click", () => command(`joint ${by("joint").value} ${button.dataset.joint}`));

function onSubmit(id, action) {
  by(id).addEventListener("submit", (event) => {
    event.preventDefault();
    action(event.target.elements, event.target);
  });
}

onSubmit("lights", (fields) => command(`lights ${fields.panel.value} ${fields.front.value}`));
onSubmit("go", (fields) => command(`go ${fields.distance.value} ${fields.height.value}`));
onSubmit("line", (fields) => command(fields[0].value));
onSubmit("question", () => act("POST", "/api/answer", { question: Number(by("question").dataset.number), text: by("answer").value }));
onSubmit("start", (fields) => {
  const day = fields.day.value === "" ? null : Number(fields.day.value);
  const texts = { plant: fields.plant.value.trim(), treatment: fields.treatment.value.trim(), notes: fields.notes.value.trim() };
  act("POST", "/api/scans", { ...texts, day, reconstruct: by("reconstruct").checked });
});

// --- polling of the state

async function follow() {
  for (;;) {
    try {
      const after = state === null ? 0 : state.version;
      const response = await send("GET", `/api/state?after=${after}&wait_s=${WAIT_S}`);
      const next = await response.json();
      if (state === null) {
        by("reconstruct").checked = !next.rig.sketch;
        by("reconstruct").parentElement.hidden = next.rig.sketch;
      }
      show(next);
    } catch (error) {
      by("activity").textContent = "no connection";
      by("activity").className = "pill lost";
      if (error.message.startsWith("401")) warn("The console was restarted. Open the new address that it printed, or log in again.");
      else if (!(error instanceof TypeError)) warn(error.message);
      await new Promise((go) => setTimeout(go, RETRY_MS));
    }
  }
}

follow();
