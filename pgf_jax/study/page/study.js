"use strict";
// The page of a participant: shows what the server says, and sends what the participant does.

const $ = (id) => document.getElementById(id);
const token = location.pathname.split("/").pop();
let socket = null, robots = new Map(), frame = null, cells = [], page = null;
let number = 0, seen = null, touched = false, submitted = {};

const now = () => performance.timeOrigin + performance.now();
const send = (message) => {
  if (socket && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
};
const time = (event, more) => send({ type: "timing", event, client_ms: now(), ...more });
// Which service an event is of.
const service = (of) => ({ robot: of.served, task: of.task, request: of.request });

// -- the connection ------------------------------------------------------------------------------

function connect() {
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/wp/${token}`);
  socket.onmessage = (event) => show(JSON.parse(event.data));
  socket.onclose = () => {
    say("The connection is lost. Trying again …");
    setTimeout(connect, 2000);
  };
}
setInterval(() => send({ type: "ping", t: now() }), 2000);

function show(message) {
  if (message.type === "page") showPage(message);
  else if (message.type === "frame") showFrame(message);
  else if (message.type === "feedback") showFeedback(message);
  else if (message.type === "problems") showProblems(message.problems);
  else if (message.type === "pong") {
    const rtt = now() - message.t;
    time("clock", { rtt_ms: rtt, offset_ms: message.server_ms + rtt / 2 - now() });
  } else if (message.type === "preparing") say("The robots are getting ready …");
  else if (message.type === "queued") say("Somebody else is taking part at the moment. You are next.");
  else if (message.type === "paused") say("The experimenter has paused the study.");
  else if (message.type === "failed") say("Something went wrong. Please tell the experimenter.");
  else if (message.type === "elsewhere") say("This study is open in another window.");
}

function say(text) {
  if (!$("block").hidden) { $("status").textContent = text; return; }
  if (page && page.kind === "questions") return;  // what was filled in stays
  $("page").replaceChildren(element("p", text));
}

function element(name, text, attributes) {
  const made = document.createElement(name);
  if (text) made.textContent = text;
  Object.entries(attributes || {}).forEach(([key, value]) => made.setAttribute(key, value));
  return made;
}

// -- pages ---------------------------------------------------------------------------------------

function showPage(message) {
  const same = page && page.step === message.step && page.kind === message.kind;
  page = message;
  document.title = $("title").textContent = message.title;
  $("progress").max = message.of - 1;
  $("progress").value = message.step;
  const block = message.kind === "practice" || message.kind === "block";
  $("block").hidden = !block;
  $("page").hidden = block;
  if (block) {
    robots = new Map(); frame = null;
    $("status").textContent = "The robots are getting ready …";
    feedback("", true);
    fit();
    $("shelves").focus();
  } else if (!(same && message.kind === "questions")) {
    const made = message.kind === "questions" ? form(message) : text(message);
    $("page").replaceChildren(...made);
    window.scrollTo(0, 0);
  }
}

function text(message) {
  const body = element("div");
  body.innerHTML = message.html;  // of the study's own Markdown, without HTML in it
  if (message.kind === "closing") return [body, element("p", message.code, { class: "code" })];
  const button = element("button", "Continue");
  const until = now() + 1000 * (message.wait_s || 0);
  const tick = () => {
    const left = Math.ceil((until - now()) / 1000);
    button.disabled = left > 0;
    button.textContent = left > 0 ? `Continue in ${left} s` : "Continue";
    if (left > 0) setTimeout(tick, 250);
  };
  tick();
  button.onclick = () => { button.disabled = true; send({ type: "done", step: message.step }); };
  return [body, button];
}

function form(message) {
  const made = element("form");
  made.append(element("h1", message.heading));
  message.items.forEach((item) => {
    const set = element("fieldset", "", { "data-name": item.name });
    set.append(element("legend", item.text));
    if (item.kind === "scale") set.append((item.most - item.least) / item.step > 10 ? scale(item) : steps(item));
    else if (item.kind === "choice") item.options.forEach((option) => {
      const label = element("label");
      label.append(element("input", "", { type: "radio", name: item.name, value: option }), ` ${option}`);
      set.append(label, element("br"));
    });
    else set.append(element("textarea", "", { name: item.name, rows: 4, maxlength: 4000 }));
    set.append(element("div", "", { class: "problem" }));
    made.append(set);
  });
  const button = element("button", "Continue", { type: "submit" });
  made.append(button);
  made.onsubmit = (event) => {
    event.preventDefault();
    send({ type: "done", step: message.step, answers: answers(made, message.items) });
  };
  return [made];
}

// A scale of few steps: a button for each.
function steps(item) {
  const made = element("div", "", { class: "steps" });
  made.append(element("span", item.low));
  for (let value = item.least; value <= item.most; value += item.step) {
    const label = element("label");
    label.append(element("input", "", { type: "radio", name: item.name, value }), String(value));
    made.append(label);
  }
  made.append(element("span", item.high));
  return made;
}

// A scale has no value until it is touched, so that its middle is nobody's answer by default.
function scale(item) {
  const made = element("div", "", { class: "scale unset" });
  const input = element("input", "", { type: "range", name: item.name, min: item.least,
    max: item.most, step: item.step, "aria-label": item.text });
  input.value = (item.least + item.most) / 2;
  const value = element("output", "–");
  const set = () => { made.classList.remove("unset"); value.textContent = input.value; };
  input.addEventListener("input", set);
  input.addEventListener("click", set);
  input.addEventListener("keydown", (event) => { if (event.key === " ") { set(); event.preventDefault(); } });
  made.append(element("span", item.low), input, element("span", item.high), value);
  return made;
}

function answers(made, items) {
  const found = {};
  items.forEach((item) => {
    const inputs = [...made.querySelectorAll(`[name="${item.name}"]`)];
    if (inputs[0].type === "range") {
      if (!inputs[0].parentElement.classList.contains("unset")) found[item.name] = Number(inputs[0].value);
    } else if (inputs[0].type === "radio") {
      const chosen = inputs.find((input) => input.checked);
      if (chosen) found[item.name] = item.kind === "scale" ? Number(chosen.value) : chosen.value;
    } else if (inputs[0].value) found[item.name] = inputs[0].value;
  });
  return found;
}

function showProblems(problems) {
  document.querySelectorAll("fieldset").forEach((set) => {
    set.querySelector(".problem").textContent = problems[set.dataset.name] || "";
  });
  const first = document.querySelector(`[data-name="${Object.keys(problems)[0]}"]`);
  if (first) first.scrollIntoView({ behavior: "smooth", block: "center" });
}

// -- the robots ----------------------------------------------------------------------------------

function showFrame(message) {
  frame = message;
  message.robots.forEach((one) => robots.set(one.robot, one));
  const all = [...robots.values()].sort((a, b) => a.robot - b.robot);
  const sure = all.some((one) => "sure" in one);
  if ($("sure").hidden === sure) { $("sure").hidden = !sure; fit(); }
  cells = Shelves.draw($("shelves"), all, frame);
  const serving = frame.served !== null;
  const asked = serving ? `${frame.served} ${frame.task} ${frame.request}` : null;
  if (serving && seen !== asked) {
    time("shown", service(frame));
    touched = false;
    feedback(`Robot ${frame.served + 1} asks: click an object that should be pushed.`, true);
  }
  seen = asked;
  const practice = frame.practice ? ` · practice: ${Math.min(...frame.practice)} of ${frame.practice[1]} pushes` : "";
  $("status").textContent = (serving ? `Robot ${frame.served + 1} asks you` : "No robot asks you now") + practice;
  $("push").disabled = !serving || !frame.target || Boolean(frame.problem);
  $("go_on").disabled = !serving;
  $("undo").disabled = !serving || frame.object === null;
}

// The shelves fill what the window has above the controls; they keep their size while robots are helped.
function fit() {
  const canvas = $("shelves");
  if (!canvas.clientWidth) return;
  const room = window.innerHeight - canvas.offsetTop - $("controls").offsetHeight - 6;
  canvas.height = Math.max(300, room) * canvas.width / canvas.clientWidth;
}
window.addEventListener("resize", fit);

function feedback(words, ok) {
  $("feedback").textContent = words;
  $("feedback").classList.toggle("refused", !ok);
}

function showFeedback(message) {
  feedback(message.text, message.ok);
  time("told", { id: message.id });
  if (message.answered) time("acknowledged", { ...submitted, id: message.id });
}

function act(what, more) {
  number += 1;
  const about = { id: number, ...(frame && frame.served !== null ? service(frame) : {}) };
  if (!touched) { time("first_input", about); touched = true; }
  const submits = what === "push" || what === "go_on";
  if (submits) submitted = { ...about };
  time(submits ? "submit" : "click", about);
  send({ type: "act", do: what, id: number, ...more });
}

$("shelves").addEventListener("click", (event) => {
  const box = $("shelves").getBoundingClientRect();
  const at = Shelves.find(cells, [...robots.values()],
    (event.clientX - box.left) * $("shelves").width / box.width,
    (event.clientY - box.top) * $("shelves").height / box.height);
  act("click", at);
});
["push", "go_on", "undo"].forEach((name) => { $(name).onclick = () => act(name); });
const KEYS = { Enter: ["push"], g: ["go_on"], Escape: ["undo"], Tab: ["next"],
  i: ["nudge", { deeper: 1, left: 0 }], k: ["nudge", { deeper: -1, left: 0 }],
  j: ["nudge", { deeper: 0, left: 1 }], l: ["nudge", { deeper: 0, left: -1 }] };
document.addEventListener("keydown", (event) => {
  if ($("block").hidden || event.ctrlKey || event.metaKey || event.altKey) return;
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  if (!(key in KEYS)) return;
  event.preventDefault();
  act(...KEYS[key]);
});
window.addEventListener("blur", () => time("focus_lost"));
window.addEventListener("focus", () => time("focus_back"));
document.addEventListener("visibilitychange", () => time(document.hidden ? "hidden" : "visible"));

connect();
