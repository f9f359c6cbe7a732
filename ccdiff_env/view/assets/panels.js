// Everything beside the map: facts of an agent, figures at the cursor, times to contact.

const KMH = 3.6;
const TTC_ROWS = 10; // agents in the matrix at most

/** New element with text and class. */
function element(tag, className, text) {
  const node = document.createElement(tag);
  if (className) node.className = className;
  if (text !== undefined) node.textContent = text;
  return node;
}

/** Facts of one agent at a step, as pairs of name and value. */
function factsOf(run, agent, at) {
  const { kind, category, length, width, drivenBy, id } = run.agents[agent];
  const facts = [["kind", category || kind]];
  if (kind !== "static") facts.push(["driven by", drivenBy]);
  facts.push(["size", `${length.toFixed(1)} × ${width.toFixed(1)} m`]);
  const pose = run.pose(agent, at), step = Math.floor(at + 1e-6);
  if (!pose) return [...facts, ["state", "not in the scene now"], ["id", id]];
  const speed = Math.hypot(pose.vx, pose.vy);
  if (kind !== "static") {
    facts.push(["speed", `${speed.toFixed(1)} m/s · ${(speed * KMH).toFixed(0)} km/h`]);
    const least = run.pairs(step)
      .filter(([a, b]) => a === agent || b === agent)
      .sort((p, q) => p[2] - q[2])[0];
    if (least) {
      const other = run.agents[least[0] === agent ? least[1] : least[0]];
      facts.push(["contact in", `${least[2].toFixed(1)} s with ${other.label}`]);
    }
  }
  facts.push(...planFacts(run, agent, step));
  facts.push(["heading", `${(wrap(pose.heading) * 180 / Math.PI).toFixed(0)}°`]);
  facts.push(["place", `${pose.x.toFixed(1)}, ${pose.y.toFixed(1)} m`], ["id", id]);
  return facts;
}

/** What the plan in force says of an agent. */
function planFacts(run, agent, step) {
  const plan = run.planAt(step), row = plan ? plan.agents.indexOf(agent) : -1;
  if (row < 0) return [];
  const age = `made ${((step - plan.step) * run.dt).toFixed(1)} s ago`;
  const facts = [["plan", plan.executed[row] ? age : `${age}, predicted only`]];
  if (plan.guided[row]) facts.push(["guided, at a cost of", plan.cost[row].toFixed(3)]);
  return facts;
}

/** Fill a list with facts: name and value, or a value for each run; the title says whose. */
function showFacts(list, title, facts) {
  list.replaceChildren(element("div", "facts-title", title));
  for (const [name, ...values] of facts) {
    const row = element("div", "fact");
    row.append(element("span", "fact-name", name));
    const both = element("span", "fact-value");
    values.forEach((value, i) => both.append(element("span", values.length > 1 ? `run-${i}` : "", value)));
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

  /** Show the figures of an agent (by id). */
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
    this.row("time to contact", "s", of("leastTtc"));
  }

  /** Show what the runs recorded; returns whether they did. */
  showRecorded() {
    const figures = new Map();
    for (const run of this.runs)
      for (const { name, unit } of run.figures) figures.set(name, unit);
    for (const [name, unit] of figures) {
      this.row(name.replaceAll("_", " "), unit, this.runs.map((run) => {
        const figure = run.figures.find((other) => other.name === name);
        return figure ? figure.values : null;
      }));
    }
    return figures.size > 0;
  }

  row(name, unit, series) {
    const row = element("div", "figure");
    const canvas = element("canvas", "figure-curve");
    const values = series.map((_, i) => element("span", `figure-value run-${i}`));
    const title = element("span", "figure-name", name);
    if (unit) title.append(element("small", "", ` ${unit}`));
    row.append(title, canvas, ...values);
    this.container.append(row);
    const known = series.filter(Boolean).flatMap((s) => Array.from(s)).filter(Number.isFinite);
    const low = Math.min(...known, 0), high = Math.max(...known, low + 1e-3);
    canvas.addEventListener("pointerdown", (event) => {
      const box = canvas.getBoundingClientRect();
      this.seek(this.start + (event.clientX - box.left) / box.width * (this.end - this.start));
    });
    this.rows.push({ canvas, values, series, low, high });
  }

  get start() { return Math.min(...this.runs.map((run) => run.start)); }
  get end() { return Math.max(...this.runs.map((run) => run.end)); }

  draw(time, colours) {
    const ratio = window.devicePixelRatio || 1;
    for (const { canvas, values, series, low, high } of this.rows) {
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
      series.forEach((s, i) => s && this.curve(context, this.runs[i], s, x, y, colours.runs[i]));
      context.fillStyle = colours.text;
      context.globalAlpha = 0.5;
      context.fillRect(x(time) - 0.5, 0, 1, height);
      context.globalAlpha = 1;
      series.forEach((s, i) => {
        const value = s ? s[indexAt(this.runs[i], s, time)] : NaN;
        values[i].textContent = Number.isFinite(value) ? brief(value) : "–";
      });
    }
  }

  curve(context, run, series, x, y, colour) {
    const lag = run.numSteps - series.length; // figures of steps start one state later
    context.strokeStyle = colour;
    context.lineWidth = 1.5;
    context.lineJoin = "round";
    context.beginPath();
    let open = false;
    series.forEach((value, i) => {
      if (!Number.isFinite(value)) { open = false; return; }
      const px = x(run.start + (i + lag) * run.dt), py = y(value);
      if (open) context.lineTo(px, py);
      else context.moveTo(px, py);
      open = true;
    });
    context.stroke();
  }
}

/** Entry of a series at a time; figures of steps have one entry less than there are states. */
function indexAt(run, series, time) {
  const lag = run.numSteps - series.length;
  return Math.max(Math.round(run.stepAt(time)) - lag, 0);
}

function brief(value) {
  const size = Math.abs(value);
  return value.toFixed(size >= 100 ? 0 : size >= 10 ? 1 : 2);
}

/** Matrix of times to contact between the agents that matter most at the cursor. */
class ContactPanel {
  /** hover([a, b] or null) is called with indices of run 0. */
  constructor(container, run, hover) {
    this.container = container;
    this.run = run;
    this.hover = hover;
    container.addEventListener("pointerleave", () => hover(null));
  }

  /** Agents in the most urgent pairs: first those of the focus, then those of the plan in force. */
  choose(step, focus) {
    const { run } = this, plan = run.planAt(step);
    const solid = (agent) => run.agents[agent].kind !== "static";
    const rank = ([a, b]) => {
      if (a === focus || b === focus) return 0;
      return plan && plan.agents.includes(a) && plan.agents.includes(b) ? 1 : 2;
    };
    const pairs = run.pairs(step)
      .filter(([a, b, ttc]) => ttc < 2 || solid(a) && solid(b))
      .sort((p, q) => rank(p) - rank(q) || p[2] - q[2]);
    const order = new Set(focus >= 0 && pairs.length ? [focus] : []);
    for (const [a, b] of pairs) {
      const more = !order.has(a) + !order.has(b);
      if (order.size + more <= TTC_ROWS) order.add(a).add(b);
    }
    return [...order].filter((agent) => run.valid(agent, step));
  }

  draw(step, focus, theme) {
    const key = `${step} ${focus} ${theme}`;
    if (key === this.key) return;
    this.key = key;
    const order = this.choose(step, focus);
    const seconds = new Map();
    for (const [a, b, ttc] of this.run.pairs(step)) seconds.set(`${a} ${b}`, ttc).set(`${b} ${a}`, ttc);
    const table = element("table", "contacts");
    const head = element("tr");
    head.append(element("th"));
    for (const agent of order) head.append(this.name(agent));
    table.append(head);
    for (const a of order) {
      const row = element("tr");
      row.append(this.name(a));
      for (const b of order) row.append(this.cell(a, b, seconds.get(`${a} ${b}`)));
      table.append(row);
    }
    const none = element("p", "quiet", "No two agents are on course to meet.");
    this.container.replaceChildren(order.length > 1 ? table : none);
  }

  name(agent) {
    const cell = element("th", "", this.run.agents[agent].label);
    cell.addEventListener("pointerenter", () => this.hover(null));
    return cell;
  }

  cell(a, b, ttc) {
    const cell = element("td", a === b ? "self" : "");
    if (a === b) return cell;
    if (ttc !== undefined) {
      cell.textContent = ttc.toFixed(1);
      const heat = 1 - Math.min(ttc / this.run.ttcCap, 1);
      cell.style.background = `rgba(214, 31, 44, ${(0.06 + 0.8 * heat * heat).toFixed(2)})`;
      if (heat > 0.7) cell.classList.add("hot");
    }
    cell.addEventListener("pointerenter", () => this.hover([a, b]));
    return cell;
  }
}
