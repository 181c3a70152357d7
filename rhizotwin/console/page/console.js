// Page of the console: polls the state, displays it, and sends the user's actions.

import { Hull } from "/hull.js";

const WAIT_S = 20;
const RETRY_MS = 2000;
const ALERT_MS = 15000;
const THUMBNAIL_PX = 160;
const secret = document.querySelector('meta[name="secret"]').content;
const client = stored(sessionStorage, "client", () => Array.from(crypto.getRandomValues(new Uint8Array(16)), (byte) => byte.toString(16).padStart(2, "0")).join(""));
const by = (id) => document.getElementById(id);
const hull = new Hull(by("hull"));
let state = null;
const shown = {}; // what each part of the page displays
let browsed = null; // the scan and the number of the picture that the user has chosen; null: the latest picture
let alerted = 0;

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

// Show an error message for a while.
function warn(text) {
  clearTimeout(alerted);
  by("alert").textContent = text;
  by("alert").hidden = text === "";
  if (text !== "") alerted = setTimeout(() => warn(""), ALERT_MS);
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
  showHistory();
  showHull();
  showDevices();
  fold("devices-box", !running);
  fold("hands", own && !running);
  showScans();
  showMessages();
  showProblems();
  by("arm").hidden = !state.rig.arm;
  by("live").setAttribute("aria-pressed", state.live);
  for (const one of document.querySelectorAll("main button, main input, main select")) {
    if (one.closest("#question, #schedule, #history, #next, table") || one.id === "latest") continue;
    one.disabled = !own || state.activity !== "";
  }
  by("why").textContent = why(running);
  by("why").hidden = by("why").textContent === "";
  by("camera").hidden = running;
  by("pause").disabled = by("continue").disabled = !own;
  by("stop").disabled = !running || state.scan.state === "stopping";
  by("schedule-start").disabled = !own || state.activity !== "";
  by("schedule-stop").disabled = !own || state.schedule?.state !== "running";
  for (const one of document.querySelectorAll("#question button, #question input")) one.disabled = !own;
}

// Return why controls are disabled, or an empty text. During a scan they are folded, and the state of the scan says why.
function why(running) {
  const { name, own } = state.controls;
  if (!own) return name === null ? "Take control of the rig to use the grey buttons." : `${name} controls the rig; take over to use the grey buttons.`;
  return running || state.activity === "" ? "" : `The rig is busy (${state.activity}); the grey buttons can be used again afterwards.`;
}

// Fold a part of the page when it can no longer be used, and unfold it when it can. The user can unfold it at any time.
function fold(id, usable) {
  if (changed(`fold ${id}`, usable)) by(id).open = usable;
}

function showDevices() {
  by("devices").replaceChildren(...state.devices.map((one) => row(one.state, one.name, one.time ? `${one.text} (at ${one.time.slice(0, 5)})` : one.text)));
  by("devices-dots").replaceChildren(...state.devices.map((one) => make("span", { className: `dot ${one.state}`, title: one.name })));
  by("devices-dots").ariaLabel = state.devices.map((one) => `${one.name}: ${one.state}`).join(", ");
}

function row(kind, name, text, soft = "", title = "") {
  return make("div", { className: "state", title }, make("span", { className: `dot ${kind}`, title: kind }), make("b", {}, name), make("span", { className: kind === "wrong" ? "wrong" : "" }, text, soft ? make("br") : "", soft ? make("span", { className: "soft" }, soft) : ""));
}

function showControl() {
  const { name, since, own, idle_s: idle } = state.controls;
  const away = idle > 60 ? `, last connected ${Math.round(idle / 60)} min ago` : "";
  by("holder").textContent = own ? `You (${name}) control the rig` : name === null ? "No one controls the rig" : `${name} has controlled the rig since ${since}${away}`;
  by("holder").className = own ? "own" : "";
  by("take").textContent = name === null ? "Take control" : "Take over";
  by("take").hidden = own;
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
  by("then").textContent = running && scan.reconstruct ? "Then it is reconstructed, and can be opened here." : "";
  by("scan-state").textContent = scan.total === 0 && running ? "not started yet" : `${scan.done} of ${scan.total} pictures, ${words[scan.state]}`;
  by("scan-error").textContent = scan.error;
  by("scan-error").hidden = scan.error === "";
  by("pause").hidden = scan.state !== "running";
  by("continue").hidden = scan.state !== "paused";
  by("stop").hidden = !running;
  const entry = state.scans.find((one) => one.name === scan.name);
  by("next").hidden = running || entry === undefined;
  if (entry !== undefined && changed("next", [entry, actionsKey()])) by("next").replaceChildren(make("div", { className: "next" }, make("p", {}, result(entry)), actions(entry)));
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
  if (!changed("plants", state.plants)) return;
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
  by("picture").hidden = picture === null && browsed === null;
  by("no-picture").hidden = !by("picture").hidden;
  by("latest").hidden = browsed === null;
  by("meters").hidden = browsed !== null;
  const source = browsed !== null ? pictureOf(browsed.scan, browsed.number) : picture === null ? "" : `/api/picture.jpg?number=${picture.number}`;
  if (source === "" || source === shown.picture) return;
  shown.picture = source;
  by("picture").src = source;
  by("picture").alt = browsed !== null ? `Picture ${browsed.number + 1} of ${browsed.scan}` : "Latest picture of the camera, markers outlined";
  by("picture-title").textContent = browsed !== null ? `picture ${browsed.number + 1} of ${browsed.scan}` : picture.title;
  if (browsed === null) by("meters").replaceChildren(...picture.meters.map((one) => row(one.state, one.name, one.value, ["good", "unknown"].includes(one.state) ? "" : one.limits, one.limits)));
}

function pictureOf(scan, number) {
  return `/api/scans/${encodeURIComponent(scan)}/pictures/${number}.jpg`;
}

// Show the pictures of the scan that the user browses, or of the latest scan, as thumbnails.
function showHistory() {
  const name = browsed?.scan ?? state.scan?.name;
  const count = state.scans.find((one) => one.name === name)?.pictures ?? 0;
  if (name !== shown.history) {
    by("history").replaceChildren();
    shown.history = name;
  }
  for (let number = by("history").childElementCount; number < count; number++) {
    const image = make("img", { src: `${pictureOf(name, number)}?width=${THUMBNAIL_PX}`, alt: `Picture ${number + 1}`, loading: "lazy" });
    by("history").append(make("button", { type: "button", onclick: () => browse({ scan: name, number }) }, image));
  }
  by("history").hidden = count === 0;
  Array.from(by("history").children, (one, number) => one.setAttribute("aria-pressed", number === browsed?.number));
}

function browse(picture) {
  browsed = picture;
  showHistory();
  showPicture();
}

async function showHull() {
  const { number, cells, radius_mm: radius, height_mm: height } = state.hull;
  by("preview").hidden = state.scan === null;
  by("hull-text").textContent = cells ? "Where the pictures so far allow roots, to about a millimetre; the reconstruction is sharper. Drag it, or use the arrow keys, to rotate it." : "It appears after the first pictures of a scan.";
  if (number === shown.hull) return;
  shown.hull = number;
  try {
    const response = await send("GET", "/api/hull");
    hull.set(new Float32Array(await response.arrayBuffer()), radius, height);
  } catch {
    shown.hull = null; // drawn with the next state; a lost connection is shown by `follow`
  }
}

// Return whether a value differs from that of the last call. Elements that have not changed keep the keyboard focus.
function changed(part, value) {
  const text = JSON.stringify(value);
  const differs = shown[part] !== text;
  shown[part] = text;
  return differs;
}

function actionsKey() {
  return [state.queue, state.controls.own, state.activity];
}

function showScans() {
  if (!changed("scans", [state.scans, actionsKey()])) return;
  const rows = state.scans.map((scan) => {
    const done = scan.error || `${scan.pictures} of ${scan.planned}${scan.running ? ", running" : scan.complete ? "" : ", interrupted"}`;
    const plant = make("td", {}, scan.plant || make("span", { className: "soft" }, "not named"), scan.about ? make("div", { className: "soft" }, scan.about) : "");
    return make("tr", {}, make("td", {}, scan.name), plant, make("td", {}, scan.date), make("td", {}, done), make("td", {}, result(scan)), make("td", { className: "actions" }, actions(scan)));
  });
  if (rows.length === 0) rows.push(make("tr", {}, make("td", { colSpan: 6, className: "soft" }, "No scans yet")));
  by("scans").tBodies[0].replaceChildren(...rows);
}

// Return the buttons and links for what can be done next with a scan.
function actions(scan) {
  const buttons = make("span", { className: "buttons" });
  const name = encodeURIComponent(scan.name);
  const queued = ["waiting", "running"].includes(scan.queue);
  const missing = state.controls.own ? "" : "take control of the rig first";
  const add = (text, action, reason) => buttons.append(make("button", { type: "button", onclick: action, disabled: reason !== "", title: reason }, text));
  const link = (text, href, more) => buttons.append(make("a", { href, ...more }, text));
  const page = { target: "_blank", rel: "noopener" };
  if (scan.error || scan.running) return buttons;
  if (scan.result && !queued) {
    link("Open in viewer", `/results/${name}/viewer`, { className: "main", ...page });
    link("Report", `/results/${name}/report.html`, page);
  }
  if (!scan.complete) add("Finish scan", () => act("POST", `/api/scans/${name}/finish`, { reconstruct: by("reconstruct").checked }), missing || (state.activity && `the rig is busy (${state.activity})`));
  if (queued) add("Cancel", () => act("DELETE", `/api/queue/${name}`), missing);
  else if (scan.complete && !scan.sketch) add(scan.result ? "Reconstruct again" : "Reconstruct", () => act("POST", "/api/queue", { scan: scan.name }), missing);
  if (scan.pictures) buttons.append(make("button", { type: "button", onclick: () => { browse({ scan: scan.name, number: 0 }); by("picture").scrollIntoView({ block: "center" }); } }, "Pictures"));
  link("Download", `/scans/${name}/dataset.zip`, {});
  return buttons;
}

// Return the result of a scan, the state of its reconstruction, or the reason why it has none.
function result(scan) {
  const job = state.queue.find((one) => one.scan === scan.name);
  if (job?.state === "waiting") return `waiting for reconstruction${job.error && `: ${job.error}`}`;
  if (job?.state === "running") return make("span", {}, `reconstructing: ${job.stage}`, make("progress", { max: 1, value: job.fraction, ariaLabel: "Reconstruction" }));
  if (job?.state === "failed") return make("span", { className: "wrong" }, `reconstruction failed: ${job.error}`);
  if (scan.result !== null) return scan.result.volume;
  if (scan.sketch) return "sketch of the emulated rig, which shows no plant and cannot be reconstructed; for pictures of roots, start the console with --fidelity render";
  return scan.complete ? "not reconstructed yet" : "";
}

function showProblems() {
  by("problems").hidden = state.problems.length === 0;
  by("problems").replaceChildren(...state.problems.map((text) => make("p", {}, text)));
}

function showMessages() {
  if (!changed("messages", state.messages)) return;
  by("messages").replaceChildren(...state.messages.map((one) => make("li", { className: one.kind }, make("time", {}, one.time), one.text)));
}

// --- actions of the user

by("take").addEventListener("click", () => {
  const { name } = state.controls;
  by("name").value = localStorage.getItem("rhizotwin-name") ?? "";
  by("other").textContent = name === null ? "Everybody who opens this page sees who controls the rig." : `${name} controls the rig now and loses control.`;
  by("who").returnValue = "";
  by("who").showModal();
  by("name").select();
});
by("who").addEventListener("close", () => {
  if (by("who").returnValue !== "take") return;
  localStorage.setItem("rhizotwin-name", by("name").value);
  act("POST", "/api/control", { name: by("name").value });
});
by("latest").addEventListener("click", () => browse(null));
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
  browsed = null;
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
