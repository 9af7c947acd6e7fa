// The operator's seat. All text from outside is set as text, never as markup.
"use strict";

const SILENT = 900; // ms without a picture until the page is grey
const MINUTE = 60000;
const PATIENCE = 2; // s until an act comes too late: who gave it may have given up
const byId = (id) => document.getElementById(id);
let link = null;
let heard = -Infinity; // when the newest picture was asked for: it is not older
let newest = null;
let asked = 0; // how many pictures have not come yet
let number = 0;
let beat = 0;
let lease = null; // {lease, axes} while it drives
let held = null; // [x, y] while a key or a button is held
let taking = false;
const own = Math.random().toString(36).slice(2);
const waiting = new Map(); // id -> what to do with the answer
const past = new Map(); // device -> [[time, numbers by name], ...]

function isConnected() {
  return link !== null && link.readyState === WebSocket.OPEN;
}

function send(act, fields, then = () => {}) {
  if (!isConnected()) {
    then(null, { text: "not sent: there is no connection to the robot" });
    return;
  }
  number += 1;
  const id = `${own}-${number}`;
  waiting.set(id, then);
  if (waiting.size > 200) waiting.delete(waiting.keys().next().value);
  const now = newest && newest.time + (performance.now() - heard) / 1000; // of the robot
  const until = now === null || ["stop", "release"].includes(act) ? undefined : now + PATIENCE;
  link.send(JSON.stringify({ v: 1, id, act, until, ...fields }));
}

// On a slow network pictures that nobody asked for would queue up, and be shown late as if new.
function look() {
  if (asked >= 4) return;
  asked += 1;
  const when = performance.now();
  send("status", {}, (found) => {
    if (found === null) return; // it was refused: the next one would be, too
    asked -= 1;
    [heard, newest] = [when, found];
    show(found);
  });
}
setInterval(look, 250);

function tell(text) {
  byId("told").textContent = text;
}

// The token comes with the address, is kept by this browser, and leaves the address bar.
function token() {
  const given = decodeURIComponent(location.hash.slice(1));
  if (given) {
    localStorage.setItem("token", given);
    history.replaceState(null, "", location.pathname);
  }
  return localStorage.getItem("token") || "";
}

function ask(text) {
  byId("login").hidden = false;
  if (text) tell(text);
}

byId("login").onsubmit = (event) => {
  event.preventDefault();
  // The whole address may be pasted, too.
  localStorage.setItem("token", byId("token").value.trim().replace(/^.*#/, ""));
  byId("token").value = "";
  byId("login").hidden = true;
  tell("");
  connect();
};
addEventListener("hashchange", () => location.hash.length > 1 && location.reload());

function connect() {
  const shown = token();
  if (!shown) {
    ask("");
    return;
  }
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  link = new WebSocket(`${scheme}://${location.host}/operate`);
  link.onopen = () => {
    link.send(shown);
    [asked, newest] = [0, null];
    past.clear(); // the clock of a robot that comes back may begin anew
    look();
    send("why", {}, showProtection);
  };
  link.onmessage = (message) => take(JSON.parse(message.data));
  link.onclose = (event) => {
    drop();
    for (const then of waiting.values()) then(null, { text: "not answered: the connection is gone" });
    waiting.clear();
    if (event.code === 4401) {
      ask("the token is wrong: each start of the robot makes a new one");
    } else {
      setTimeout(connect, 1000);
    }
  };
}

function take(found) {
  if (found.beat) {
    beat = found.beat;
    push();
  } else if (found.lapsed) {
    if (lease !== null && found.lapsed === lease.lease) {
      lease = null;
      drop(); // what is held must be pressed again
    }
  } else if ("ok" in found) {
    const then = waiting.get(found.id);
    waiting.delete(found.id);
    if (!found.ok) tell(found.error.text);
    if (then) then(found.ok ? found.result : null, found.error);
  }
}

setInterval(() => {
  const silent = performance.now() - heard > SILENT;
  document.body.classList.toggle("silent", silent);
  byId("link").textContent = silent ? "nothing heard: this is old" : "live";
  byId("resume").disabled = silent;
  if (silent) drop();
}, 100);

// What is shown.

function cell(row, text, kind) {
  const found = row.appendChild(document.createElement("td"));
  found.textContent = text;
  if (kind) found.className = kind;
  return found;
}

// A phone shows numbers with their names, and none that is nothing.
function numbers(row, found) {
  for (const [label, text] of Object.entries(found)) {
    cell(row, text, text ? "number" : "number none").dataset.label = label;
  }
}

const hertz = (rate) => (rate === null ? "" : rate.toFixed(rate >= 10 ? 0 : 1));
function age(seconds) {
  if (seconds === null) return "";
  return seconds < 1 ? `${Math.round(seconds * 1000)} ms` : `${seconds.toFixed(0)} s`;
}

function show(status) {
  byId("name").textContent = status.robot;
  document.title = `${status.robot} - esair`;
  byId("halted").hidden = status.halted === null;
  byId("reason").textContent = `HALTED: ${status.halted}`;
  byId("modes").hidden = status.mode === null;
  if (document.activeElement !== byId("mode")) {
    byId("mode").replaceChildren(...status.modes.map((each) => new Option(each, each)));
    byId("mode").value = status.mode;
  }
  const resources = document.createDocumentFragment();
  for (const each of status.resources) {
    const row = resources.appendChild(document.createElement("tr"));
    cell(row, each.name).title = each.name;
    cell(row, each.state, each.state);
    const holder = each.kind === "actuator" ? `${each.holder || "free"}  ` : "";
    const why = each.error || each.stands;
    cell(row, why || holder + (each.value || ""), why ? "text why" : "text").title = each.rule || "";
    plot(cell(row, "", "plot"), each, status.time);
    const { rate, late, losses: lost, refusals: refused } = each;
    numbers(row, { Hz: hertz(rate), age: age(each.age), late, lost, refused });
  }
  byId("resources").replaceChildren(resources);
  const behaviors = document.createDocumentFragment();
  for (const each of status.behaviors) {
    const row = behaviors.appendChild(document.createElement("tr"));
    cell(row, each.name).title = each.name;
    cell(row, each.state, each.state);
    cell(row, each.detail || each.error || each.kind, "text").title = each.detail || each.error || "";
    const { rate, late, restarts, refusals: refused } = each;
    numbers(row, { Hz: hertz(rate), late, restarts, refused });
  }
  byId("behaviors").replaceChildren(behaviors);
  choose(status.resources.filter((each) => each.kind === "actuator"));
  showOperations(status.resources);
  showSettings(status.resources);
}

const COLORS = ["#2780a8", "#d97706", "#2a9d4e", "#9d4edd"];

function plot(place, each, now) {
  const points = past.get(each.name) || [];
  past.set(each.name, points);
  if (Object.keys(each.numbers).length) points.push([now * 1000, each.numbers]);
  while (points.length && points[0][0] < now * 1000 - MINUTE) points.shift();
  if (!points.length) return;
  const canvas = place.appendChild(document.createElement("canvas"));
  [canvas.width, canvas.height] = [160, 22];
  const pen = canvas.getContext("2d");
  const names = Object.keys(points[points.length - 1][1]);
  place.title = names.filter(Boolean).join(", ");
  names.forEach((name, index) => {
    const track = points.filter((point) => name in point[1]).map(([time, found]) => [time, found[name]]);
    const values = track.map((point) => point[1]);
    const low = Math.min(...values);
    const span = Math.max(...values) - low || 1;
    pen.strokeStyle = COLORS[index];
    pen.beginPath();
    for (const [time, height] of track) {
      pen.lineTo(160 - ((now * 1000 - time) / MINUTE) * 160, 20 - ((height - low) / span) * 18);
    }
    pen.stroke();
  });
}

// What is driven: the only actuator, or the only one with two axes to steer by; else it is asked.
const STEERS = [["linear", "angular"], ["left", "right"]];
function choose(actuators) {
  const list = byId("actuator");
  const names = actuators.map((each) => each.name);
  if ([...list.options].slice(1).map((each) => each.value).join() !== names.join()) {
    const before = list.value;
    list.replaceChildren(new Option("what to drive?", ""), ...names.map((name) => new Option(name, name)));
    list.value = names.includes(before) ? before : "";
  }
  if (list.value === "" && !list.dataset.touched) {
    const steered = actuators.filter((each) => STEERS.some((axes) => axes.every((axis) => axis in each.numbers)));
    const found = names.length === 1 ? actuators : steered;
    if (found.length === 1) list.value = found[0].name;
  }
  for (const button of document.querySelectorAll("#pad button")) button.disabled = list.value === "";
}
byId("actuator").onchange = (event) => {
  drop(); // what is held was for another one
  event.target.dataset.touched = "yes";
  event.target.blur();
};
byId("speed").onpointerup = (event) => event.target.blur(); // the next arrow key drives, and changes no speed

function showProtection(found) {
  if (found) byId("protection").textContent = found.map((each) => each.text).join("\n\n");
}
setInterval(() => send("why", {}, showProtection), 2000);

const inputs = new Map();
let settings = "";
function showSettings(resources) {
  const found = resources.flatMap((resource) => resource.settings.map((each) => [`${resource.name}.${each.name}`, each]));
  const declared = JSON.stringify(found, (key, value) => (key === "value" ? undefined : value));
  if (declared !== settings) {
    settings = declared;
    inputs.clear();
    byId("settings").replaceChildren(...found.map(setting));
  }
  for (const [name, each] of found) {
    const input = inputs.get(name);
    if (document.activeElement !== input) input.value = String(each.value);
  }
}

function setting([name, each]) {
  const label = document.createElement("label");
  const input = document.createElement("input");
  const isLimited = each.min !== null || each.max !== null;
  const range = each.choices?.join(", ") ?? (isLimited ? `${each.min ?? "…"} to ${each.max ?? "…"}` : "");
  label.append(`${name} `, input, ` ${each.unit}${range && ` (${range})`}`);
  label.title = each.doc;
  input.onchange = () => change(name, each.type, input);
  inputs.set(name, input);
  return label;
}

// What is no number, and neither true nor false, the robot refuses: emptied is not 0.
function valueOf(text, kind) {
  const word = text.trim();
  if (kind === "bool") return word === "true" || (word === "false" ? false : text);
  return ["float", "int"].includes(kind) && word !== "" && isFinite(word) ? Number(word) : text;
}

function change(setting, kind, input) {
  send("set", { setting, value: valueOf(input.value, kind) }, (found) => {
    if (found) tell("");
    input.blur();
  });
}

let operations = "";
function showOperations(resources) {
  const names = resources.map((each) => [each.name, each.operations]);
  if (JSON.stringify(names) === operations) return; // what is typed there stays
  operations = JSON.stringify(names);
  byId("operations").replaceChildren(
    ...names.flatMap(([resource, found]) => found.map((each) => operation(resource, each)))
  );
}

function operation(resource, each) {
  const form = document.createElement("form");
  const button = form.appendChild(document.createElement("button"));
  button.textContent = `${resource} ${each.name}`;
  button.title = each.doc;
  const inputs = each.parameters.map((taken) => {
    const label = form.appendChild(document.createElement("label"));
    const input = document.createElement("input");
    input.placeholder = taken.required ? taken.type : String(taken.default);
    input.required = taken.required;
    label.append(`${taken.name} `, input);
    return [taken, input];
  });
  const output = form.appendChild(document.createElement("output"));
  form.onsubmit = (event) => {
    event.preventDefault();
    document.activeElement.blur(); // the next space or Enter does not do it again
    const given = inputs.filter(([, input]) => input.value !== "");
    const fields = Object.fromEntries(given.map(([taken, input]) => [taken.name, valueOf(input.value, taken.type)]));
    output.textContent = "...";
    send("operate", { resource, operation: each.name, fields }, (found, error) => {
      output.textContent = error ? error.text : found === null ? "done" : JSON.stringify(found);
    });
  };
  return form;
}

// What is done.

byId("halt").onclick = () => {
  tell("STOP is sent, and not answered yet");
  send("stop", { reason: "the page" }, (found, error) => {
    const silent = error ? [error] : found.told.filter((each) => !each.answered);
    tell(silent.map((each) => `STOP: ${each.text}`).join("; "));
  });
};
byId("mode").onchange = (event) => {
  send("mode", { name: event.target.value });
  event.target.blur();
};
byId("resume").onclick = () => send("resume", {});

const KEYS = { ArrowUp: [1, 0], ArrowDown: [-1, 0], ArrowLeft: [0, 1], ArrowRight: [0, -1] };

function hold(direction) {
  if (byId("actuator").value === "") {
    byId("driving").textContent = "choose what to drive first";
    return;
  }
  held = direction;
  if (lease !== null) {
    push();
  } else if (!taking) {
    taking = true;
    const actuator = byId("actuator").value;
    send("lease", { actuator, seconds: 0.5 }, (found) => {
      taking = false;
      if (found === null) return;
      lease = found;
      beat = found.beat;
      if (held === null || byId("actuator").value !== actuator) drop(); // let go before it began
      push();
    });
  }
}

function drop() {
  if (held !== null) byId("driving").textContent = "released";
  held = null;
  if (lease === null) return;
  send("release", { lease: lease.lease });
  lease = null;
}

function push() {
  if (held === null || lease === null) return;
  const command = commandOf(held, lease.axes, byId("speed").value / 100);
  send("drive", { lease: lease.lease, beat, command }, (found) => {
    if (found && held !== null) byId("driving").textContent = found.written ? JSON.stringify(found.command) : `refused by ${found.holder}: ${found.rule}`;
  });
}

function commandOf([forward, left], axes, speed) {
  const part = (direction, limits) => {
    const [low, high] = limits || [-1, 1];
    return speed * direction * Math.abs(direction >= 0 ? high : low);
  };
  const names = Object.keys(axes);
  if (names.length === 1 && names[0] === "") return part(forward, axes[""]);
  const command = Object.fromEntries(names.map((name) => [name, 0]));
  if ("left" in axes && "right" in axes) {
    const whole = (number) => Math.max(-1, Math.min(1, number));
    command.left = part(whole(forward - left), axes.left);
    command.right = part(whole(forward + left), axes.right);
    return command;
  }
  [forward, left].forEach((direction, index) => {
    if (index < names.length) command[names[index]] = part(direction, axes[names[index]]);
  });
  return command;
}

const types = (event) => ["INPUT", "SELECT"].includes(event.target.tagName);
addEventListener("keydown", (event) => {
  // Of a key with a modifier the end may never come: macOS tells none while Command is held.
  // A space stops, as at a terminal, whatever else is held.
  if (event.metaKey || event.ctrlKey || event.altKey || event.key === " ") return drop();
  if (types(event) || !(event.key in KEYS)) return;
  event.preventDefault();
  if (!event.repeat) hold(KEYS[event.key]);
});
addEventListener("keyup", (event) => {
  if (event.key in KEYS) drop();
});
for (const button of document.querySelectorAll("#pad button")) {
  button.onpointerdown = (event) => {
    if (event.button !== 0) return; // a context menu keeps the end of the others
    button.setPointerCapture(event.pointerId);
    hold([Number(button.dataset.x), Number(button.dataset.y)]);
  };
  button.oncontextmenu = (event) => {
    event.preventDefault(); // a finger that stays asks for one
    event.stopPropagation();
  };
  button.onpointerup = button.onpointercancel = button.onlostpointercapture = drop;
}
// A gamepad drives with its left stick while a shoulder button is held: a dead man's handle.
const DEAD = 0.15;
let padHolds = false;
setInterval(() => {
  const pad = [...navigator.getGamepads()].find((each) => each && each.connected && each.buttons.length > 5);
  const handle = pad !== undefined && (pad.buttons[4].pressed || pad.buttons[5].pressed);
  const [x, y] = handle ? pad.axes.map((axis) => (Math.abs(axis) < DEAD ? 0 : axis)) : [0, 0];
  if (handle && (x || y) && !document.hidden) {
    if (!padHolds || held !== null) hold([-y, -x]); // after a gap it is let go first
    padHolds = true;
  } else if (padHolds) {
    padHolds = false;
    drop();
  }
}, 50);

// While a menu is open or something is dragged, no key and no button tells its end.
for (const each of ["blur", "contextmenu", "dragstart"]) addEventListener(each, drop);
document.addEventListener("visibilitychange", () => document.hidden && drop());

connect();
