"use strict";

const $ = (id) => document.getElementById(id);
// Ten minutes, a point a second.
const POINTS = 600;
const CHARTS = [
  { title: "turbulence", unit: "px", keys: ["turbulence (px)"], names: [""] },
  { title: "rate", unit: "Hz", keys: ["input rate (Hz)", "output rate (Hz)"], names: ["in", "out"] },
  { title: "latency", unit: "ms", keys: ["latency from arrival p50 (ms)", "latency from arrival p95 (ms)"], names: ["p50", "p95"] },
];
// A press that moves less, in CSS pixels, is a corner; one that moves more, a rectangle.
const TAP = 8;

const state = {
  socket: null, delay: 500, picture: null, bitmap: null, points: [], there: false,
  regions: [], changed: false, draft: null, press: null,
};

function element(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

/* The connection */

function connect() {
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  const socket = new WebSocket(`${scheme}://${location.host}/ws`);
  socket.binaryType = "arraybuffer";
  state.socket = socket;
  socket.onopen = () => { state.delay = 500; state.points = []; banner(); };
  socket.onmessage = (event) => {
    if (event.data instanceof ArrayBuffer) showPicture(event.data);
    else {
      const message = JSON.parse(event.data);
      HANDLERS[message.kind]?.(message);
    }
  };
  socket.onclose = () => {
    state.socket = null;
    banner();
    setTimeout(connect, state.delay);
    state.delay = Math.min(2 * state.delay, 5000);
  };
}

function send(message) {
  if (state.socket?.readyState !== WebSocket.OPEN) return false;
  state.socket.send(JSON.stringify(message));
  return true;
}

let lastSummary = null;

function banner() {
  const summary = lastSummary;
  let text = "";
  if (state.socket?.readyState !== WebSocket.OPEN) text = "turbseg_view does not answer; trying again …";
  else if (summary && !summary.node) text = "No node is heard. Does turbseg_node run, in this domain?";
  else if (summary && !summary.there) text = `Nothing from ${summary.node} for ${Math.round(summary.silent)} s. Has it ended?`;
  else if (summary?.problem) text = `No picture: ${summary.problem}`;
  const box = $("banner");
  box.hidden = !text;
  if (box.textContent !== text) box.textContent = text;
  document.body.classList.toggle("stale", Boolean(text));
}

/* What came */

const HANDLERS = {
  summary(message) {
    lastSummary = message;
    state.there = message.there;
    for (const point of message.points) {
      state.points.push(Object.fromEntries(message.point_names.map((key, i) => [key, point[i]])));
    }
    state.points.splice(0, Math.max(state.points.length - POINTS, 0));
    const level = message.there ? message.level : "error";
    $("node").textContent = message.node || "turbseg";
    document.title = message.node || "turbseg";
    $("level").textContent = message.there ? message.level : "away";
    $("level").className = `pill ${level}`;
    const others = message.others.length ? ` · also heard: ${message.others.join(", ")} (--node)` : "";
    $("message").textContent = (message.there ? message.message : "") + others;
    const camera = message.figures.camera;
    $("camera").hidden = !camera;
    $("camera").textContent = camera ? `camera ${camera}` : "";
    showObjects(message.objects);
    $("figures").replaceChildren(...Object.entries(message.figures).map(([key, value]) =>
      element("div", {}, element("dt", { textContent: key }), element("dd", { textContent: value }))));
    drawCharts();
    banner();
  },
  parameters(message) { showParameters(message.parameters); },
  set(message) {
    const shown = document.querySelector(`.parameter[data-name="${CSS.escape(message.name)}"]`);
    if (!shown) return;
    shown.querySelector(".refused").textContent = message.problem;
    if (message.problem) shown.restore();
  },
  regions(message) {
    // What is being drawn here is not taken away by another browser's save.
    if (!state.changed) state.regions = message.regions;
    if (message.problem) $("saved").textContent = message.problem;
    $("save").title = `to ${message.file}`;
    showRegions();
  },
  saved(message) {
    if (!message.problem || message.problem.startsWith("saved")) state.changed = false;
    $("saved").textContent = message.problem || message.done;
    $("saved").classList.toggle("error", Boolean(message.problem));
    showRegions();
  },
};

function showObjects(objects) {
  $("none").hidden = objects.length > 0;
  $("rows").replaceChildren(...objects.map((each) => {
    const dot = element("span", { className: "dot" });
    dot.style.background = each.colour;
    const since = new Date(Date.now() - 1000 * each.seen).toLocaleTimeString();
    return element("tr", {},
      element("td", {}, dot, String(each.id)),
      element("td", { textContent: each.size ? `${each.size[0]} × ${each.size[1]} px` : "" }),
      element("td", { textContent: each.speed === null ? "" : `${Math.round(each.speed)} px/s` }),
      element("td", { textContent: `${each.whole ? "" : "before "}${since} (${each.whole ? "" : "≥ "}${duration(each.seen)})` }));
  }));
}

function duration(seconds) {
  const whole = Math.round(seconds);
  return whole < 60 ? `${whole} s` : `${Math.floor(whole / 60)} min ${whole % 60} s`;
}

/* The picture */

async function showPicture(data) {
  try {
    const length = new DataView(data).getUint32(0);
    const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
    const blob = new Blob([new Uint8Array(data, 4 + length)], { type: "image/jpeg" });
    const bitmap = await createImageBitmap(blob);
    state.bitmap?.close();
    state.bitmap = bitmap;
    state.picture = header;
    $("empty").hidden = true;
    draw();
  } finally {
    send({ kind: "shown" });
  }
}

function draw() {
  const { picture, bitmap } = state;
  if (!picture) return;
  const canvas = $("canvas");
  const ratio = window.devicePixelRatio || 1;
  const width = Math.max(Math.round(canvas.clientWidth * ratio), 1);
  const height = Math.max(Math.round(width * picture.height / picture.width), 1);
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const pen = canvas.getContext("2d");
  pen.drawImage(bitmap, 0, 0, width, height);
  // A pixel's centre lies at a whole number.
  const place = ([x, y]) => [(x + 0.5) * width / picture.width, (y + 0.5) * height / picture.height];
  const line = Math.max(1.5 * ratio, width / 640);
  pen.lineJoin = "round";
  if (!picture.drawn) {
    for (const each of picture.objects) {
      pen.strokeStyle = each.colour;
      pen.lineWidth = line;
      pen.setLineDash([]);
      for (const outline of each.outlines) trace(pen, outline.map(place), true);
      if ($("trails").checked && each.trail.length > 1) {
        pen.lineWidth = 0.7 * line;
        pen.setLineDash([2 * line, 2 * line]);
        trace(pen, each.trail.map(place), false);
      }
      const corners = each.outlines.flat();
      if (corners.length) {
        label(pen, String(each.id), place([Math.max(...corners.map((c) => c[0])), Math.min(...corners.map((c) => c[1]))]), each.colour, ratio);
      }
    }
  }
  pen.setLineDash([]);
  for (const region of state.regions) drawRegion(pen, region, true, ratio);
  if (state.draft) drawRegion(pen, state.draft, false, ratio);
}

function trace(pen, points, closed) {
  pen.beginPath();
  points.forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
  if (closed) pen.closePath();
  pen.stroke();
}

function label(pen, text, [x, y], colour, ratio) {
  const size = 13 * ratio;
  pen.setLineDash([]);
  pen.font = `600 ${size}px system-ui, sans-serif`;
  const width = pen.measureText(text).width;
  const left = Math.max(0, Math.min(x + 3 * ratio, pen.canvas.width - width));
  const base = Math.max(y - 3 * ratio, size);
  pen.lineWidth = 3 * ratio;
  pen.strokeStyle = "#000b";
  pen.strokeText(text, left, base);
  pen.fillStyle = colour;
  pen.fillText(text, left, base);
}

function drawRegion(pen, region, closed, ratio) {
  const { width, height } = pen.canvas;
  const points = region.polygon.map(([x, y]) => [x * width, y * height]);
  if (!points.length) return;
  const colour = region.kind === "ignore" ? "#ff5a4f" : "#3ddc84";
  pen.strokeStyle = colour;
  pen.lineWidth = 2 * ratio;
  pen.setLineDash([8 * ratio, 5 * ratio]);
  trace(pen, points, closed);
  pen.setLineDash([]);
  if (closed) {
    pen.fillStyle = `${colour}2a`;
    pen.fill();
    label(pen, region.name || region.kind, [Math.min(...points.map((p) => p[0])), Math.min(...points.map((p) => p[1])) + 18 * ratio], colour, ratio);
  } else {
    pen.fillStyle = colour;
    for (const [x, y] of points) pen.fillRect(x - 3 * ratio, y - 3 * ratio, 6 * ratio, 6 * ratio);
  }
}

/* Regions */

const HINT = "Tap corner after corner, then Close; or drag a rectangle.";

function begin(kind) {
  state.draft = state.draft?.kind === kind ? null : { kind, polygon: [] };
  showRegions();
}

function finish() {
  const { draft } = state;
  if (!draft || draft.polygon.length < 3) return;
  const count = state.regions.filter((each) => each.kind === draft.kind).length + 1;
  state.regions = [...state.regions, { name: `${draft.kind} ${count}`, ...draft }];
  state.draft = null;
  state.changed = true;
  showRegions();
}

function showRegions() {
  const { draft } = state;
  for (const kind of ["ignore", "include"]) $(kind).setAttribute("aria-pressed", String(draft?.kind === kind));
  $("drawing").hidden = !draft;
  $("close").disabled = !draft || draft.polygon.length < 3;
  $("undo").disabled = !draft?.polygon.length;
  $("hint").textContent = draft ? HINT : "";
  $("canvas").classList.toggle("draws", Boolean(draft));
  $("save").disabled = !state.changed;
  $("regions").replaceChildren(...state.regions.map((region, index) => {
    const name = element("input", { type: "text", value: region.name, maxLength: 60, ariaLabel: "name of the region" });
    name.onchange = () => { region.name = name.value; changed(); };
    const remove = element("button", { textContent: "Delete", ariaLabel: `delete ${region.name}` });
    remove.onclick = () => { state.regions = state.regions.filter((_, i) => i !== index); changed(); };
    return element("li", {}, element("span", { className: `pill ${region.kind === "ignore" ? "error" : "ok"}`, textContent: region.kind }), name, remove);
  }));
  draw();
}

function changed() {
  state.changed = true;
  showRegions();
}

/* Where a pointer is, in fractions of the picture. */
function position(event) {
  const box = $("canvas").getBoundingClientRect();
  const inside = (value) => Math.min(Math.max(value, 0), 1);
  return [inside((event.clientX - box.left) / box.width), inside((event.clientY - box.top) / box.height)];
}

function prepareDrawing() {
  const canvas = $("canvas");
  canvas.onpointerdown = (event) => {
    if (!state.draft || !state.picture || event.button) return;
    canvas.setPointerCapture(event.pointerId);
    state.press = { x: event.clientX, y: event.clientY, at: position(event), before: state.draft.polygon };
  };
  canvas.onpointermove = (event) => {
    const { press } = state;
    if (!press || !state.draft || press.before.length) return;
    press.far ||= Math.hypot(event.clientX - press.x, event.clientY - press.y) > TAP;
    if (!press.far) return;
    const [[left, top], [right, bottom]] = [press.at, position(event)];
    state.draft.polygon = [[left, top], [right, top], [right, bottom], [left, bottom]];
    draw();
  };
  canvas.onpointerup = () => {
    const { press } = state;
    state.press = null;
    if (!press || !state.draft) return;
    if (press.far) { finish(); return; }
    state.draft.polygon = [...press.before, press.at];
    showRegions();
  };
  canvas.onpointercancel = () => {
    if (state.press && state.draft) state.draft.polygon = state.press.before;
    state.press = null;
    draw();
  };
  $("ignore").onclick = () => begin("ignore");
  $("include").onclick = () => begin("include");
  $("close").onclick = finish;
  $("undo").onclick = () => { state.draft.polygon = state.draft.polygon.slice(0, -1); showRegions(); };
  $("cancel").onclick = () => { state.draft = null; showRegions(); };
  $("save").onclick = () => {
    $("saved").textContent = send({ kind: "save", regions: state.regions }) ? "saving …" : "not saved: turbseg_view does not answer";
  };
  $("trails").onchange = draw;
  new ResizeObserver(draw).observe($("stage"));
}

/* Curves */

const SVG = "http://www.w3.org/2000/svg";

function prepareCharts() {
  for (const chart of CHARTS) {
    const svg = document.createElementNS(SVG, "svg");
    svg.setAttribute("viewBox", "0 0 100 100");
    svg.setAttribute("preserveAspectRatio", "none");
    svg.setAttribute("role", "img");
    svg.setAttribute("aria-label", chart.title);
    chart.lines = chart.keys.map((_, i) => {
      const group = document.createElementNS(SVG, "g");
      group.setAttribute("class", i ? "second" : "first");
      svg.append(group);
      return group;
    });
    chart.now = element("span");
    chart.from = element("span");
    chart.top = element("span");
    $("charts").append(element("figure", {},
      element("figcaption", {}, element("span", { textContent: `${chart.title} (${chart.unit})` }), chart.now),
      element("div", { className: "axis" }, chart.top),
      svg,
      element("div", { className: "axis" }, chart.from, element("span", { textContent: "now" }))));
  }
}

function drawCharts() {
  const { points } = state;
  for (const chart of CHARTS) {
    const known = points.flatMap((point) => chart.keys.map((key) => point[key])).filter((v) => v !== null);
    const top = round125(Math.max(...known, 1e-9));
    chart.top.textContent = known.length ? `${top}` : "";
    chart.from.textContent = points.length > 1 ? `${duration(points.length - 1)} ago` : "";
    chart.now.replaceChildren(...chart.keys.flatMap((key, i) => {
      const value = points.at(-1)?.[key];
      const name = element("span", { className: i ? "second" : "first", textContent: chart.names[i] });
      return [i ? " " : "", name, " ", element("b", { textContent: value == null ? "–" : String(value) })];
    }));
    chart.keys.forEach((key, i) => {
      // A gap where there was no figure.
      const runs = [[]];
      points.forEach((point, at) => {
        if (point[key] === null) runs.push([]);
        else runs.at(-1).push(`${(100 * at / Math.max(points.length - 1, 1)).toFixed(2)},${(100 - 96 * point[key] / top).toFixed(2)}`);
      });
      chart.lines[i].replaceChildren(...runs.filter((run) => run.length).map((run) => {
        const line = document.createElementNS(SVG, "polyline");
        line.setAttribute("points", run.join(" "));
        return line;
      }));
    });
  }
}

/* The next of 1, 2, 5, 10, 20, ... */
function round125(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  const step = [1, 2, 5, 10].find((each) => each * power >= value * 0.999);
  return Number((step * power).toPrecision(3));
}

/* Parameters */

function showParameters(parameters) {
  const box = $("parameters");
  const names = parameters.map((each) => each.name).join();
  if (box.dataset.names !== names) {
    box.dataset.names = names;
    box.replaceChildren(...parameters.map(parameterControl));
    if (!parameters.length) box.append(element("p", { className: "quiet", textContent: "none while the node is away" }));
  }
  for (const each of parameters) box.querySelector(`[data-name="${CSS.escape(each.name)}"]`).show(each.value);
}

function parameterControl(parameter) {
  const { name, kind, minimum, maximum, choices } = parameter;
  const refused = element("p", { className: "refused" });
  refused.setAttribute("role", "alert");
  const row = element("div", { className: "row" });
  const description = element("p", { className: "quiet", textContent: parameter.description, hidden: true });
  const explain = element("button", { className: "explain", textContent: "?", ariaLabel: `what ${name} is` });
  explain.setAttribute("aria-expanded", "false");
  explain.onclick = () => {
    description.hidden = !description.hidden;
    explain.setAttribute("aria-expanded", String(!description.hidden));
  };
  const shown = element("div", { className: "parameter" },
    element("div", { className: "row" }, element("label", { textContent: name, htmlFor: `p-${name}` }), explain),
    description, row, refused);
  shown.dataset.name = name;
  let last = parameter.value;
  const set = (value) => {
    refused.textContent = send({ kind: "set", name, value }) ? "" : "turbseg_view does not answer";
  };
  let put;
  if (kind === "bool") {
    const box = element("input", { type: "checkbox", id: `p-${name}` });
    box.onchange = () => set(box.checked);
    put = (value) => { box.checked = value; };
    row.append(box);
  } else if (kind === "int" || kind === "float") {
    const number = element("input", { type: "number", id: `p-${name}`, step: kind === "int" ? 1 : "any" });
    if (minimum !== null) number.min = minimum;
    if (maximum !== null) number.max = maximum;
    // Sent as it is typed: it is the node that says what it refuses.
    number.onchange = () => { if (number.value !== "") set(Number(number.value)); };
    put = (value) => { number.value = value; };
    if (minimum !== null && maximum !== null) {
      const slider = element("input", { type: "range", min: 0, max: 1, step: "any", ariaLabel: name });
      // Where all that is of interest lies at the lower end, the slider is fine there.
      const power = parameter.value - minimum < 0.1 * (maximum - minimum) ? 3 : 1;
      const value = () => {
        const exact = minimum + (maximum - minimum) * slider.value ** power;
        return kind === "int" ? Math.round(exact) : Number(exact.toPrecision(3));
      };
      slider.oninput = () => { number.value = value(); };
      slider.onchange = () => set(value());
      const putNumber = put;
      put = (given) => {
        putNumber(given);
        slider.value = ((given - minimum) / (maximum - minimum)) ** (1 / power);
      };
      row.append(slider);
    }
    row.append(number);
  } else if (choices.length) {
    const select = element("select", { id: `p-${name}` }, ...choices.map((each) => element("option", { textContent: each })));
    select.onchange = () => set(select.value);
    put = (value) => { select.value = value; };
    row.append(select);
  } else {
    const isList = kind === "list";
    const text = element("input", { type: "text", id: `p-${name}` });
    text.onchange = () => set(isList ? text.value.split(",").map((each) => each.trim()).filter(Boolean) : text.value);
    put = (value) => { text.value = isList ? value.join(", ") : value; };
    row.append(text);
  }
  shown.show = (value) => {
    last = value;
    // Not under the fingers of whoever types.
    if (!row.contains(document.activeElement) || document.activeElement.type === "range") put(value);
  };
  shown.restore = () => put(last);
  put(last);
  return shown;
}

prepareDrawing();
prepareCharts();
showRegions();
connect();
setInterval(banner, 1000);
