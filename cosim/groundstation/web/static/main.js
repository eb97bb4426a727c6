// The page: takes what the link brings, shows it, and sends what is asked for.

import { Engines } from "./engines.js";
import { History } from "./history.js";
import { Horizon } from "./horizon.js";
import { Link } from "./link.js";
import { Strips } from "./panels.js";
import { get, number, write } from "./show.js";
import { Sticks } from "./sticks.js";
import { Strip } from "./strip.js";
import { EnginePage, EventPage, ParameterPage } from "./tables.js";
import { Tabs } from "./tabs.js";
import { Track } from "./track.js";
import { View } from "./view.js";

const FAR_M = 1000; // a place farther away than this is asked about, as ground stations do
const STALE_S = 1; // a state older than this is shown as old: the flight stands still

const horizon = new Horizon(get("horizon"));
const engines = new Engines(get("jets"));
const strip = new Strip(get("strip"));
const track = new Track(get("map"), (north, east) => {
  get("goto-north").value = north.toFixed(1);
  get("goto-east").value = east.toFixed(1);
  get("goto-go").focus({ preventScroll: true });
});
const link = new Link({ message: take, state: linked });
const sticks = new Sticks((where) => link.tell("Sticks", where));
const history = new History();
const view = new View(get("scene"), history);
const strips = new Strips(history);
const enginePage = new EnginePage(history);
const events = new EventPage();
const parameters = new ParameterPage(async (name, value) => (await ask("SetParameter", { name, value }, `${name} = ${value}`)).accepted);
const tabs = new Tabs(() => { changed = true; });

let flight = null;
let now = null;
let changed = false;
let heard = 0; // the number of the last message; after a lost link they come again

// --- what comes in ---

function take(told) {
  if (told.type === "flight") begin(told);
  if (told.type === "parameters") parameters.begin(told.table);
  if (told.type === "values") parameters.take(told.values);
  if (told.type === "messages") told.lines.forEach(message);
  if (told.type === "state") {
    now = told;
    changed = true;
    track.take(told);
    strip.take(told.strip);
    history.take(told.t, told.row);
    view.take();
    events.take(told);
  }
}

function begin(told) {
  const again = flight && flight.number === told.number;
  flight = told;
  engines.begin(told);
  write(get("title"), told.vehicle);
  document.title = `${told.vehicle} – hexjet`;
  write(get("facts"), `flight ${told.number}, scenario ${told.scenario}, controller ${told.controller}`);
  const names = [...new Set(told.engines.map((engine) => engine.name))];
  write(get("engine-name"), names.join(", "));
  get("mode-choice").replaceChildren(new Option("…", ""), ...told.modes.map((mode) => new Option(mode, mode)));
  if (!again) {
    get("takeoff-height").value = Number(told.takeoff_m.toFixed(1));
    track.clear();
    strip.clear();
    history.begin(told.columns);
    view.clear();
    strips.begin(told);
    enginePage.begin(told);
    events.begin();
  }
  if (view.begin(told)) draw("map");
}

/** The scene or the map. */
function draw(what) {
  for (const each of document.querySelectorAll("[data-view]")) each.setAttribute("aria-pressed", String(each.dataset.view === what));
  get("scene").hidden = what !== "scene";
  get("map").hidden = get("map-tools").hidden = what !== "map";
  changed = true;
}

function message({ number: count, t, severity, text }) {
  if (count <= heard) return;
  heard = count;
  events.message({ t, severity, text });
  const list = get("messages"), line = document.createElement("div"), at = document.createElement("time");
  const bottom = list.scrollHeight - list.scrollTop - list.clientHeight < 40;
  line.className = severity;
  at.textContent = `${t.toFixed(1)} s`;
  const words = document.createElement("span");
  words.textContent = text;
  line.append(at, words);
  list.append(line);
  while (list.children.length > 200) list.firstChild.remove();
  if (bottom) list.scrollTop = list.scrollHeight;
}

// --- what is shown ---

function show() {
  requestAnimationFrame(show);
  if (!get("map").hidden) track.draw();
  if (!changed || !now || !flight) return;
  changed = false;
  const state = now;
  bar(state);
  ({ flight: dashboard, strips: () => strips.panels.draw(), engines: () => enginePage.draw(state, history) })[tabs.now]?.(state);
}

/** What is above every page. */
function bar(state) {
  chip("mode", state.mode, state.failsafe ? "bad" : "");
  get("mode").title = state.failsafe ? `Failsafe: ${state.failsafe}` : "Flight mode";
  const off = state.engines_do === "off";
  chip("armed", state.armed ? "armed" : off && state.landed !== "on_ground" ? "engines off" : state.ready ? "ready" : "not ready", state.armed ? "warn" : state.ready ? "good" : "");
  chip("landed", state.landed.replace("_", " "), "");
  write(get("time"), number(state.t));
  const { asked, reached, missed } = state.pace;
  write(get("pace"), number(reached, 2));
  write(get("pace-asked"), asked === null ? " × real time" : ` of ${asked} × real time`);
  write(get("late"), String(missed));
  write(get("arm"), state.armed ? "Disarm" : "Arm");
  sticks.mode(flight.direct.includes(state.mode), state.landed === "on_ground");
  ended();
}

/** The page of the flight. */
function dashboard(state) {
  const attitude = state.attitude_deg;
  view.draw();
  horizon.show(attitude, state.armed ? state.attitude_asked_deg : null);
  const [north, east, down] = state.velocity;
  write(get("height"), number(state.height));
  write(get("height-asked"), number(state.armed ? state.height_asked : null));
  write(get("climb"), number(-down));
  write(get("speed"), number(Math.hypot(north, east)));
  write(get("heading"), number((Math.round(attitude[2]) + 360) % 360, 0));
  write(get("roll"), number(attitude[0]));
  write(get("pitch"), number(attitude[1]));
  write(get("remaining"), state.remaining === null ? "–" : number(100 * state.remaining, 0));
  write(get("place"), `N ${number(state.position[0])} m, E ${number(state.position[1])} m`);
  engines.show(state.jets);
  strip.draw();
  const [measured, predicted] = strip.last;
  write(get("rate-measured"), number(measured));
  write(get("rate-predicted"), number(predicted));
  write(get("refusals"), state.armed ? state.failsafe && `Failsafe: ${state.failsafe}` : state.refusals.length ? `Not ready to arm: ${state.refusals.join("; ")}` : "");
}

function chip(id, text, kind) {
  write(get(id), text);
  get(id).className = `chip ${kind}`;
}

const LINKS = {
  connecting: ["connecting", "warn", "Connecting to the simulation."],
  live: ["live", "good", ""],
  silent: ["silent", "bad", "The link is silent: nothing shown here is new."],
  lost: ["link lost", "bad", "The link to the simulation is lost: nothing shown here is new. Trying again."],
  over: ["ended", "bad", "The session has ended. What is shown is its last moment."],
};

function linked(state, why) {
  const [text, kind, words] = LINKS[state];
  chip("link", text, kind);
  document.body.classList.toggle("stale", state !== "live");
  enable(state === "live");
  if (state !== "live") sticks.off("Off: the link was lost.");
  banner(words && why && state === "lost" ? `${words} (${why})` : words, true);
}

function enable(on) {
  for (const each of document.querySelectorAll("[data-needs]")) if (each.disabled === on) each.disabled = !on;
}

function banner(text, bad, restart = false) {
  get("banner").hidden = !text;
  get("banner").classList.toggle("bad", bad);
  write(get("banner-text"), text);
  get("restart").hidden = !restart;
}

function ended() {
  if (!link.live) return;
  enable(!now.ending);
  if (now.ending) sticks.off("Off: the flight is over.");
  if (now.ending) {
    const { outcome, reason } = now.ending;
    banner(`The flight has ended, ${outcome}: ${reason}.`, outcome !== "completed", true);
    chip("armed", "flight over", "bad");
  } else if (now.age_s > STALE_S) banner(`The simulation stands still: its last step was ${number(now.age_s, 0)} s ago.`, true);
  else banner("", false);
}

// --- what is asked for ---

async function ask(request, fields, words) {
  const told = get("answer");
  const answer = await link.ask(request, fields);
  told.classList.toggle("bad", !answer.accepted);
  write(told, answer.accepted ? `${words}: ${answer.text || "done"}` : answer.text || `${words}: refused`);
  return answer;
}

function sure(title, text, yes) {
  const dialog = get("confirm");
  write(get("confirm-title"), title);
  write(get("confirm-text"), text);
  write(get("confirm-yes"), yes);
  dialog.returnValue = "no";
  dialog.showModal();
  return new Promise((done) => dialog.addEventListener("close", () => done(dialog.returnValue === "yes"), { once: true }));
}

get("arm").addEventListener("click", () => ask(now?.armed ? "Disarm" : "Arm", {}, now?.armed ? "disarm" : "arm"));
get("takeoff").addEventListener("click", () => {
  const height = get("takeoff-height");
  if (height.reportValidity()) ask("Takeoff", { altitude_m: height.valueAsNumber }, "take-off");
});
get("hold").addEventListener("click", () => ask("Hold", {}, "hold"));
get("land").addEventListener("click", () => ask("Land", {}, "land"));
get("rtl").addEventListener("click", () => ask("ReturnHome", {}, "return"));
get("mode-choice").addEventListener("change", async (event) => {
  const mode = event.target.value;
  event.target.value = "";
  if (mode) await ask("SetMode", { mode }, `mode ${mode}`);
});
get("kill").addEventListener("click", async () => {
  const text = now?.landed === "on_ground" ? "All engines are shut off at once." : "It is in the air: all engines are shut off at once, and it falls.";
  if (await sure("Shut the engines off?", text, "Shut off")) ask("Kill", { force: true }, "kill");
});
get("goto").addEventListener("invalid", () => {
  get("answer").classList.add("bad");
  write(get("answer"), "go there: North and East must be numbers, in metres");
}, { capture: true });
get("goto").addEventListener("submit", async (event) => {
  event.preventDefault();
  const north = get("goto-north").valueAsNumber, east = get("goto-east").valueAsNumber;
  const [n, e] = now?.position ?? [0, 0], apart = Math.hypot(north - n, east - e);
  const text = `N ${number(north)} m, E ${number(east)} m is ${number(apart / 1000)} km from where the vehicle is.`;
  if (apart > FAR_M && !(await sure("Fly that far?", text, "Go there"))) return track.mark(null, null);
  track.mark(north, east);
  ask("Goto", { north, east }, `go to N ${number(north)} m, E ${number(east)} m`);
});
get("restart").addEventListener("click", () => ask("Restart", {}, "new flight"));
get("map-in").addEventListener("click", () => track.zoom(1 / 1.5));
get("map-out").addEventListener("click", () => track.zoom(1.5));
get("map-fit").addEventListener("click", () => track.fit());
get("map-clear").addEventListener("click", () => track.clear());
for (const button of document.querySelectorAll("[data-view]")) button.addEventListener("click", () => draw(button.dataset.view));
addEventListener("keydown", (event) => {
  if (event.key === "c" && !event.ctrlKey && !event.metaKey && !event.altKey && !event.target.closest("input, select, dialog")) view.scene?.views();
});
for (const button of document.querySelectorAll("[data-axis]")) {
  button.addEventListener("click", () => {
    for (const each of document.querySelectorAll("[data-axis]")) each.setAttribute("aria-pressed", each === button);
    strip.choose(Number(button.dataset.axis));
  });
}
link.open();
show();
