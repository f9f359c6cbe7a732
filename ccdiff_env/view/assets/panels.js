// Everything beside the map: what happened, captions of an agent, figures at the cursor.

const KMH = 3.6;
const RUN_DASHES = [[], [5, 3], [2, 2], [8, 2, 2, 2]];
const LANE_TITLES = { ego: "Ego", guided: "Guided vehicles", others: "Others" };

/** New element with text and class. */
function element(tag, className, text) {
  const node = document.createElement(tag);
  if (className) node.className = className;
  if (text !== undefined) node.textContent = text;
  return node;
}

/** Captions of one agent at a step, as pairs of name and value. */
function captionsOf(run, agent, at) {
  const { kind, length, width, drivenBy } = run.agents[agent];
  const captions = kind === "static" ? [] : [["driven by", drivenBy]];
  const lasting = [["size", `${length.toFixed(1)} × ${width.toFixed(1)} m`]];
  const pose = run.pose(agent, at), step = Math.floor(at + 1e-6);
  if (!pose) return [...captions, ["state", "not in the scene now"], ...lasting];
  const speed = Math.hypot(pose.vx, pose.vy);
  if (run.arrived(agent, step)) captions.push(["state", "has reached its goal"]);
  if (kind !== "static") {
    captions.push(["speed", `${speed.toFixed(1)} m/s · ${(speed * KMH).toFixed(0)} km/h`]);
    const least = run.meeting(agent, step);
    if (least) {
      const other = run.agents[least[0] === agent ? least[1] : least[0]];
      captions.push(["contact in", `${least[2].toFixed(1)} s with ${other.label}`]);
    }
  }
  captions.push(...planCaptions(run, agent, step));
  return [...captions, ...lasting];
}

/** What the plan in force says of an agent. */
function planCaptions(run, agent, step) {
  const plan = run.planAt(step), row = plan ? plan.agents.indexOf(agent) : -1;
  if (row < 0) return [];
  if (run.agents[agent].driver === "ego" && !plan.follows_plan[row]) return [];
  const age = `made ${((step - plan.made_at) * run.dt).toFixed(1)} s ago`;
  const captions = [["plan", plan.follows_plan[row] ? age : `${age}, not followed`]];
  if (plan.guided[row]) captions.push(["guided, at a cost of", plan.realism_cost[row].toFixed(3)]);
  return captions;
}

/** Fill a list with captions: name and value, or a value for each run; the title says whose. */
function showCaptions(list, title, captions, marks = []) {
  list.replaceChildren(element("div", "captions-title", title));
  for (const [name, ...values] of captions) {
    const row = element("div", "caption");
    row.append(element("span", "caption-name", name));
    const both = element("span", "caption-value");
    values.forEach((value, i) => {
      const shown = element("span", "", value);
      if (values.length > 1) shown.prepend(badge(marks[i] ?? i));
      both.append(shown);
    });
    row.append(both);
    list.append(row);
  }
}

/** Figures with a value at the cursor for each run and a curve over the run. */
class FiguresPanel {
  constructor(container, runs, seek) {
    Object.assign(this, { container, runs, seek, rows: [] });
  }

  /** Show the info columns of an agent (by id). */
  showAgent(agentId) {
    if (agentId === this.agentId) return;
    this.agentId = agentId;
    this.rows = [];
    this.container.replaceChildren();
    const of = (name) => this.runs.map((run) => {
      const agent = run.indexOf.get(agentId);
      return agent === undefined ? null : run[name](agent);
    });
    if (this.runs.every((run) => !run.indexOf.has(agentId))) {
      this.container.append(element("p", "quiet", "No agent is chosen."));
      return;
    }
    this.row("speed", "m/s", of("speeds"));
    this.row("acceleration", "m/s²", of("accelerations"));
    this.row("time to contact", "s", of("leastTtc"), this.runs[0].ttcCap - 1e-3);
  }

  /** A value from `cap` on is none. */
  row(name, unit, series, cap = Infinity) {
    const row = element("div", "figure"), title = element("span", "figure-name", name);
    const canvas = element("canvas", "figure-curve");
    canvas.setAttribute("aria-hidden", "true");
    const values = series.map((_, i) => element("span", `figure-value run-${i % RUN_DASHES.length}`));
    title.append(element("small", "", ` ${unit}`));
    row.append(title, canvas, ...values);
    this.container.append(row);
    const known = series.filter(Boolean).flatMap((s) => Array.from(s)).filter(Number.isFinite);
    const low = Math.min(...known, 0), high = Math.max(...known, low + 1e-3);
    canvas.addEventListener("pointerdown", (event) => {
      const box = canvas.getBoundingClientRect(), [start, end] = spanOf(this.runs);
      this.seek(start + (event.clientX - box.left) / box.width * (end - start));
    });
    this.rows.push({ canvas, values, series, low, high, cap });
  }

  draw(time, chrome) {
    for (const { canvas, values, series, low, high, cap } of this.rows) {
      drawCurves(canvas, this.runs, series, low, high, time, chrome);
      series.forEach((s, i) => {
        const value = s ? s[Math.round(this.runs[i].stepAt(time))] : NaN;
        values[i].textContent = Number.isFinite(value) && value < cap ? brief(value) : "–";
      });
    }
  }
}

/** A curve for each run that has a series, over the time of all of them, and a line at the cursor. */
function drawCurves(canvas, runs, series, low, high, time, chrome) {
  const { clientWidth: width, clientHeight: height } = canvas;
  if (!width) return;
  const context = clearedContext(canvas, width, height), [start, end] = spanOf(runs);
  const x = (t) => width * (t - start) / Math.max(end - start, 1e-6);
  const y = (v) => height - 2 - (height - 4) * (v - low) / (high - low);
  context.fillStyle = chrome.track;
  context.fillRect(0, y(0) - 0.5, width, 1);
  context.lineWidth = 1.5;
  context.lineJoin = "round";
  series.forEach((values, index) => {
    const run = runs[index], which = index % RUN_DASHES.length;
    context.strokeStyle = chrome.runs[which];
    context.setLineDash(RUN_DASHES[which]);
    context.beginPath();
    let open = false;
    values?.forEach((value, i) => {
      const [px, py] = [x(run.start + i * run.dt), y(value)];
      if (open) context.lineTo(px, py);
      else context.moveTo(px, py);
      open = Number.isFinite(value);
    });
    context.stroke();
  });
  context.setLineDash([]);
  context.fillStyle = chrome.text;
  context.globalAlpha = 0.5;
  context.fillRect(x(time) - 0.5, 0, 1, height);
  context.globalAlpha = 1;
}

function brief(value) {
  const size = Math.abs(value);
  return value.toFixed(size >= 100 ? 0 : size >= 10 ? 1 : 2);
}

/** Letter of a run, in its colour. */
function badge(index) {
  const mark = element("i", `badge run-${index % RUN_DASHES.length}`, String.fromCharCode(65 + index));
  mark.setAttribute("aria-hidden", "true");
  return mark;
}

/** What became of a run, as nodes: the ego's fate, and collisions of the others. */
function verdict({ tone, text, others }) {
  const nodes = [element("strong", `verdict ${tone}`, text)];
  if (others) nodes.push(element("span", "quiet", `others: ${others} collision${others > 1 ? "s" : ""}`));
  return nodes;
}

/** What happened, by whose it is; a click goes there. */
class EventsPanel {
  /** goTo(run, event) is called with what is clicked. */
  constructor(container, runs, goTo) {
    for (const [lane, title] of Object.entries(LANE_TITLES)) {
      const found = runs.flatMap((run, index) => run.events
        .filter((event) => event.lane === lane && event.kind !== "overlap").map((event) => ({ run, index, event })));
      if (!found.length) continue;
      found.sort((p, q) => p.run.timeOf(p.event) - q.run.timeOf(q.event));
      const list = element("ul", "events");
      list.append(...merged(found).map((entry) => this.entry(entry, runs.length > 1, goTo)));
      container.append(element("h3", "events-head", `${title} · ${found.length}`), list);
    }
    if (!container.childElementCount) container.append(element("p", "quiet", "Nothing of note."));
  }

  entry({ run, indices, event }, several, goTo) {
    const item = element("li"), button = element("button", `event ${event.kind}`);
    button.append(element("span", "event-time", `${(event.step * run.dt).toFixed(1)} s`));
    if (several) button.append(...indices.map(badge));
    button.append(element("span", "", event.text));
    button.addEventListener("click", () => goTo(run, event));
    item.append(button);
    return item;
  }
}

/** What happens at one moment in the same words in several runs is told once. */
function merged(found) {
  const told = new Map();
  for (const { run, index, event } of found) {
    const key = `${run.timeOf(event).toFixed(2)} ${event.text}`;
    if (told.has(key)) told.get(key).indices.push(index);
    else told.set(key, { run, indices: [index], event });
  }
  return [...told.values()];
}
