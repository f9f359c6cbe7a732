// Everything beside the map: what happened, captions of an agent, info columns at the cursor, contacts.

const KMH = 3.6;
const TTC_ROWS = 5; // pairs in the list at most
const STATIONARY_MPS = 0.3;
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
    const least = run.pairs(step)
      .filter(([a, b]) => a === agent || b === agent)
      .sort((p, q) => p[2] - q[2])[0];
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
    this.container = container;
    this.runs = runs;
    this.seek = seek;
    this.rows = [];
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
    const row = element("div", "figure");
    const canvas = element("canvas", "figure-curve");
    canvas.setAttribute("aria-hidden", "true");
    const values = series.map((_, i) => element("span", `figure-value run-${i % RUN_DASHES.length}`));
    const title = element("button", "figure-name", name);
    title.title = `${name}: large or small`;
    title.setAttribute("aria-expanded", "false");
    title.addEventListener("click", () => {
      title.setAttribute("aria-expanded", row.classList.toggle("tall"));
      this.redraw();
    });
    if (unit) title.append(element("small", "", ` ${unit}`));
    row.append(title, canvas, ...values);
    this.container.append(row);
    const known = series.filter(Boolean).flatMap((s) => Array.from(s)).filter(Number.isFinite);
    const low = Math.min(...known, 0), high = Math.max(...known, low + 1e-3);
    canvas.addEventListener("pointerdown", (event) => {
      const box = canvas.getBoundingClientRect();
      this.seek(this.start + (event.clientX - box.left) / box.width * (this.end - this.start));
    });
    this.rows.push({ canvas, values, series, low, high, cap });
  }

  get start() { return Math.min(...this.runs.map((run) => run.start)); }
  get end() { return Math.max(...this.runs.map((run) => run.end)); }

  redraw() {
    if (this.drawn) this.draw(...this.drawn);
  }

  draw(time, colours) {
    this.drawn = [time, colours];
    const ratio = window.devicePixelRatio || 1;
    for (const { canvas, values, series, low, high, cap } of this.rows) {
      const width = canvas.clientWidth, height = canvas.clientHeight;
      if (!width) continue;
      resizeCanvas(canvas, width, height, ratio);
      const context = canvas.getContext("2d");
      context.setTransform(ratio, 0, 0, ratio, 0, 0);
      context.clearRect(0, 0, width, height);
      const x = (t) => width * (t - this.start) / Math.max(this.end - this.start, 1e-6);
      const y = (v) => height - 2 - (height - 4) * (v - low) / (high - low);
      context.fillStyle = colours.track;
      context.fillRect(0, y(0) - 0.5, width, 1);
      series.forEach((s, i) => s && this.curve(context, i, s, x, y, colours.runs));
      context.fillStyle = colours.text;
      context.globalAlpha = 0.5;
      context.fillRect(x(time) - 0.5, 0, 1, height);
      context.globalAlpha = 1;
      if (height > 60) this.scale(context, low, high, height, colours);
      series.forEach((s, i) => {
        const value = s ? s[Math.round(this.runs[i].stepAt(time))] : NaN;
        values[i].textContent = Number.isFinite(value) && value < cap ? brief(value) : "–";
      });
    }
  }

  /** Least and greatest value of a large curve. */
  scale(context, low, high, height, colours) {
    context.fillStyle = colours.faint;
    context.font = "10px system-ui, sans-serif";
    context.fillText(brief(high), 2, 10);
    context.fillText(brief(low), 2, height - 3);
  }

  curve(context, index, series, x, y, colours) {
    const run = this.runs[index], which = index % RUN_DASHES.length;
    context.strokeStyle = colours[which];
    context.setLineDash(RUN_DASHES[which]);
    context.lineWidth = 1.5;
    context.lineJoin = "round";
    context.beginPath();
    let open = false;
    series.forEach((value, i) => {
      if (!Number.isFinite(value)) { open = false; return; }
      const px = x(run.start + i * run.dt), py = y(value);
      if (open) context.lineTo(px, py);
      else context.moveTo(px, py);
      open = true;
    });
    context.stroke();
    context.setLineDash([]);
  }
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
  /** goTo(run, event) is called with what is clicked; changed() when flags come or go. */
  constructor(container, runs, flags, goTo, changed) {
    for (const [lane, title] of Object.entries(LANE_TITLES)) {
      const found = runs.flatMap((run, index) => run.events
        .filter((event) => event.lane === lane).map((event) => ({ run, index, event })));
      if (!found.length) continue;
      found.sort((p, q) => p.run.timeOf(p.event) - q.run.timeOf(q.event));
      const head = element("div", "events-head");
      const shown = element("button", "chip", "flags");
      shown.title = `Flags of these on the time line: ${title}`;
      shown.setAttribute("aria-label", `flags on the time line: ${title}`);
      shown.setAttribute("aria-pressed", flags[lane]);
      shown.addEventListener("click", () => {
        flags[lane] = !flags[lane];
        shown.setAttribute("aria-pressed", flags[lane]);
        changed();
      });
      head.append(element("h3", "", `${title} · ${found.length}`), shown);
      const list = element("ul", "events");
      const told = merged(found);
      const exact = told.filter(({ event }) => event.kind !== "overlap");
      const noise = told.filter(({ event }) => event.kind === "overlap");
      list.append(...exact.map((entry) => this.entry(entry, runs.length > 1, goTo)));
      container.append(head, list);
      if (!noise.length) continue;
      const fold = element("details"), rest = element("ul", "events");
      rest.append(...noise.map((entry) => this.entry(entry, runs.length > 1, goTo)));
      fold.append(element("summary", "", `overlaps with the log · ${noise.length}`), rest);
      container.append(fold);
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

/** The pairs that meet soonest at the cursor, those of the chosen agent first. */
class ContactPanel {
  /** hover(run, [a, b] or null) and choose(run, [a, b]) are called with indices of that run. */
  constructor(container, runs, hover, choose) {
    Object.assign(this, { container, runs, hover, choose, rows: [] });
    container.addEventListener("pointerleave", () => hover(runs[0], null));
  }

  /** The pairs that matter as [run, a, b, seconds]: of what moves, obstacles only where they are close. */
  pairs(time, focusId) {
    return this.runs.flatMap((run) => {
      const step = Math.floor(run.stepAt(time) + 1e-6), plan = run.planAt(step), focus = run.indexOf.get(focusId);
      const rank = ([a, b]) => {
        if (a === focus || b === focus) return 0;
        return plan && plan.agents.includes(a) && plan.agents.includes(b) ? 1 : 2;
      };
      const moves = (agent) => {
        const pose = run.pose(agent, step);
        return pose && Math.hypot(pose.vx, pose.vy) > STATIONARY_MPS;
      };
      const solid = (agent) => run.agents[agent].kind !== "static";
      return run.pairs(step)
        .filter(([a, b, ttc]) => (moves(a) || moves(b)) && (ttc < 2 || solid(a) && solid(b)))
        .map(([a, b, ttc]) => [run, a, b, ttc, rank([a, b])]);
    }).sort((p, q) => p[4] - q[4] || p[3] - q[3]).slice(0, TTC_ROWS);
  }

  draw(time, focus, chrome) {
    const pairs = this.pairs(time, focus), key = pairs.map(([run, a, b]) => `${this.runs.indexOf(run)} ${a} ${b}`).join();
    if (key !== this.key || !pairs.length) {
      this.key = key;
      this.rows = pairs.map(([run, a, b]) => this.row(run, a, b));
      const none = element("p", "quiet", "No two agents are on course to meet within 10 s.");
      this.container.replaceChildren(...(pairs.length ? this.rows.map((row) => row.button) : [none]));
    }
    this.rows.forEach((row, i) => {
      const [run, , , seconds] = pairs[i];
      row.value.textContent = `${seconds.toFixed(1)} s`;
      row.button.classList.toggle("hot", seconds < 2);
      this.curve(row, run, run.stepAt(time), chrome);
    });
  }

  row(run, a, b) {
    const { agents } = run;
    const button = element("button", "contact"), canvas = element("canvas", "figure-curve");
    const value = element("span", "figure-value");
    canvas.setAttribute("aria-hidden", "true");
    button.title = `${agents[a].title} and ${agents[b].title}: show both`;
    if (this.runs.length > 1) button.append(badge(this.runs.indexOf(run)));
    button.append(element("span", "figure-name", `${agents[a].label} – ${agents[b].label}`), canvas, value);
    button.addEventListener("pointerenter", () => this.hover(run, [a, b]));
    button.addEventListener("focus", () => this.hover(run, [a, b]));
    button.addEventListener("blur", () => this.hover(run, null));
    button.addEventListener("click", () => this.choose(run, [a, b]));
    return { button, canvas, value, series: run.pairSeries(a, b) };
  }

  /** Time to contact over the run, low where it is short. */
  curve({ canvas, series }, run, step, chrome) {
    const ratio = window.devicePixelRatio || 1, { clientWidth: width, clientHeight: height } = canvas;
    if (!width) return;
    resizeCanvas(canvas, width, height, ratio);
    const context = canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    const x = (i) => width * i / Math.max(series.length - 1, 1);
    context.strokeStyle = chrome.runs[0];
    context.lineWidth = 1.5;
    context.beginPath();
    series.forEach((value, i) => {
      const y = height - 2 - (height - 4) * value / run.ttcCap;
      if (i) context.lineTo(x(i), y);
      else context.moveTo(x(i), y);
    });
    context.stroke();
    context.fillStyle = chrome.text;
    context.globalAlpha = 0.5;
    context.fillRect(x(step) - 0.5, 0, 1, height);
    context.globalAlpha = 1;
  }
}
