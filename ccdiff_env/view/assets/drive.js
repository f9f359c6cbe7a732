// The playground: the world of the package as WebAssembly, drawn as replays are, driven by keys.

const STEP_SECONDS = 0.1, STATE = 8;
const REPLAY_SECONDS = 2, REPLAY_RATE = 0.35; // of the end, again and slower
const STILL_SECONDS = 0.7, ON_SECONDS = 2; // what is seen of the end itself, and of the world at criticality 0 after it
const WAIT_SECONDS = 4; // a car that nobody drives rolls off by itself
const CALM = "At criticality 0, the same keys";
const DRIVE_KEYS = {
  ArrowUp: "gas", w: "gas", ArrowDown: "brake", s: "brake",
  ArrowLeft: "left", a: "left", ArrowRight: "right", d: "right",
};
const KEYS = ["gas", "brake", "left", "right"];

/** The worker's tasks, see engine.js, as promises. */
class Engine {
  constructor(source) {
    this.worker = new Worker(URL.createObjectURL(new Blob([source], { type: "text/javascript" })));
    this.waiting = new Map();
    this.worker.onmessage = ({ data: { id, value, error } }) => {
      const { done, fail } = this.waiting.get(id);
      this.waiting.delete(id);
      if (error === undefined) done(value);
      else fail(new Error(error));
    };
  }

  ask(task, given) {
    const id = this.last = (this.last || 0) + 1;
    return new Promise((done, fail) => {
      this.waiting.set(id, { done, fail });
      this.worker.postMessage({ id, task, given });
    });
  }
}

/** Keys of a drive as a link has them: a letter for those held, and for how many steps. */
function written(keys) {
  let text = "";
  for (let i = 0, j; i < keys.length; i = j) {
    for (j = i; j < keys.length && keys[j] === keys[i];) j++;
    text += String.fromCharCode(97 + keys[i]) + (j - i);
  }
  return text;
}

/** Keys that a link has, no more than a drive takes. */
function read(text) {
  const keys = [], { steps } = SETTINGS.most;
  for (const [, held, count] of text.matchAll(/([a-p])(\d{1,3})/g)) {
    if (keys.length >= steps) break;
    keys.push(...Array(Math.min(+count, steps - keys.length)).fill(held.charCodeAt(0) - 97));
  }
  return keys;
}

/** Goals of drives that stay: the least seconds by what was played. */
class Score {
  constructor() {
    try { this.best = JSON.parse(localStorage.getItem("ccdiff-env goals")) || {}; } catch { this.best = {}; }
  }

  /** Keep a goal; returns whether it is the soonest there. */
  keep(key, seconds) {
    if (this.best[key] <= seconds) return false;
    this.best[key] = seconds;
    try { localStorage.setItem("ccdiff-env goals", JSON.stringify(this.best)); } catch { /* kept nowhere */ }
    return true;
  }

  /** What is said of it where something is played. */
  said(key) {
    const goals = Object.keys(this.best).length, best = this.best[key];
    return (goals ? ` · ${counted(goals, "goal")}` : "") + (best ? ` · your best here ${best.toFixed(1)} s` : "");
  }
}

/** A run of the same scene without states: those of a world are written into it. */
function emptied(run) {
  const a = Object.fromEntries(Object.entries(run.a).map(([name, values]) => [name, values.slice().fill(0)]));
  const agents = run.agents.map((agent) => ({ ...agent }));
  return Object.assign(Object.create(Run.prototype), run, { a, agents, events: [], plans: [], goal: null });
}

function write(run, step, states) {
  run.agents.forEach((_, i) => {
    const [x, y, heading, vx, vy, valid] = states.subarray(i * STATE, (i + 1) * STATE), at = i * run.numSteps + step;
    Object.entries({ x, y, heading, vx, vy, valid }).forEach(([name, value]) => { run.a[name][at] = value; });
  });
}

/** The plan of a step, see rust/wasm, as runs have it; null without one. */
function planOf(numbers, run) {
  if (!numbers.length) return null;
  const [made_at, count, steps] = numbers, row = 3 + 2 * steps, end = 3 + count * row;
  const rows = Array.from({ length: count }, (_, i) => numbers.subarray(3 + i * row, 3 + (i + 1) * row));
  const agents = rows.map(([agent]) => agent), graph = [...numbers.subarray(end)];
  const coordinate = (axis) => Float32Array.from(rows.flatMap((of) =>
    [run.a["xy"[axis]][of[0] * run.numSteps + made_at], ...of.subarray(3).filter((_, i) => i % 2 === axis)]));
  return {
    made_at, agents, x: coordinate(0), y: coordinate(1), num_samples: 1, num_points: steps + 1,
    guided: rows.map(([, guided]) => guided), follows_plan: rows.map(([, , follows]) => follows),
    // row i is influenced by column j
    edges: graph.flatMap((on, at) => (on ? [[agents[at % count], agents[Math.floor(at / count)]]] : [])),
  };
}

/** Of plans, what leads one agent to the ego. */
function plansOf(plans, agent) {
  return plans.map((plan) => {
    const row = plan.agents.indexOf(agent), from = row * plan.num_points, points = [from, from + plan.num_points];
    if (row < 0) return { ...plan, agents: [], edges: [] };
    return {
      ...plan, agents: [agent], guided: [plan.guided[row]], follows_plan: [plan.follows_plan[row]],
      x: plan.x.slice(...points), y: plan.y.slice(...points),
      edges: plan.edges.filter(([p, q]) => p === agent && q === 0),
    };
  });
}

/** The ground, on it the way of the ego's log with a ring at its end, and outlines of those in other worlds. */
class Way extends Ground {
  ghosts = []; // colour, and a function of the step that gives a pose and a size

  constructor(run, log) {
    super(run);
    this.log = log;
  }

  draw(context, colours, pixel) {
    super.draw(context, colours, pixel);
    const { x, y } = this.log.a, last = this.log.numSteps - 1;
    context.strokeStyle = colours.replay;
    context.lineCap = context.lineJoin = "round";
    context.globalAlpha = 0.6;
    context.lineWidth = Math.max(0.3, 2 * pixel);
    context.setLineDash([0.1, 1.6]);
    context.beginPath();
    for (let i = 0; i <= last; i++) context.lineTo(x[i], y[i]);
    context.stroke();
    context.setLineDash([]);
    context.globalAlpha = 1;
    context.strokeStyle = colours.goal;
    context.lineWidth = Math.max(0.3, 2.5 * pixel);
    context.beginPath();
    context.arc(x[last], y[last], 2.2, 0, 2 * Math.PI);
    context.stroke();
    for (const [name, pose, { length, width }] of this.ghosts) {
      const found = pose();
      if (!found) continue;
      context.save();
      context.translate(found.x, found.y);
      context.rotate(found.heading);
      context.setLineDash([0.8, 0.5]);
      context.lineWidth = Math.max(0.2, 2 * pixel);
      context.strokeStyle = context.fillStyle = colours[name];
      context.strokeRect(-length / 2, -width / 2, length, width);
      context.globalAlpha = 0.2;
      context.fillRect(-length / 2, -width / 2, length, width);
      context.restore();
    }
  }
}

/** State of the page. It has what a pane and the legend ask a player for. */
class Drive extends View {
  constructor(engine, rivals) {
    super();
    Object.assign(this, { engine, rivals, settings: SETTINGS, score: new Score() });
    this.headingUp = !matchMedia("(prefers-reduced-motion)").matches;
    this.focus = "ego";
    this.held = new Set();
    this.panes = this.runs = [];
    this.time = 0;
  }

  async open(name) {
    const of = (kind) => document.querySelector(`script.${kind}[data-scene="${CSS.escape(name)}"]`);
    const [run, log, bytes] = await Promise.all([readRun(of("run")), readRun(of("run")), inflate(of("bytes"))]);
    const road = { way: JSON.parse(of("run").dataset.way), top: +of("run").dataset.top };
    const scene = { bytes: new Uint8Array(bytes), ...road };
    await Promise.all([this.engine.ask("load", scene), this.rivals.ask("load", scene)]);
    this.runs = [run];
    this.log = log;
    $("stage").querySelectorAll(".pane").forEach((pane) => pane.remove());
    run.title = name;
    run.outcome = { tone: "plain", text: "driven by keys", others: 0 };
    this.panes = [new Pane($("stage"), run, 0)];
    this.panes[0].ground = new Way(run, log);
    this.panes[0].root.append(element("p", "pane-note hint", "Steer ← →, brake ↓: the car rolls by itself. Orange vehicles want to hit you."));
    const { canvas } = this.panes[0];
    listenToGestures(canvas, {
      zoom: (factor, x, y) => {
        this.camera.zoom(factor, x, y, canvas.clientWidth, canvas.clientHeight, true);
        this.touch();
      },
      tap: () => this.roll(),
    });
    this.camera.scale = Math.max(Math.min(this.panes[0].width, this.panes[0].height) / 75, 5);
    await this.begin();
  }

  /** Name of the network that drives the others, if one does. */
  get network() { return Object.keys(this.settings.configs[$("traffic").value].named_drivers)[0]; }

  /** A configuration of the settings with a criticality, that of the slider by default. */
  config(name, criticality = +$("criticality").value) {
    const config = this.settings.configs[name], { network } = this;
    if (!network) return JSON.stringify(config);
    const usual = config.named_drivers[network][network];
    const options = { ...usual, criticality, num_samples: criticality > 0 ? usual.num_samples : 1 };
    return JSON.stringify({ ...config, named_drivers: { [network]: { [network]: options } } });
  }

  /** Begin the scene again; with the keys of a link, drive it so. */
  async begin(script = null) {
    const turn = this.turn = (this.turn || 0) + 1, traffic = $("traffic").value;
    this.going = false;
    const seen = await this.engine.ask("reset", this.config(traffic));
    if (turn !== this.turn) return;
    this.script = script;
    this.keys = [];
    this.asked = false;
    this.calm = null;
    this.left = WAIT_SECONDS;
    $("card").hidden = true;
    if (this.raced !== this.key) {
      this.raced = this.key;
      this.result = null;
      this.race(this.key);
    }
    const run = this.runs[0];
    run.a.valid.fill(0);
    run.pairs.fill([]);
    Object.assign(run, { events: [], plans: [], goal: null });
    Object.assign(this.layers, { plans: false, graph: false });
    run.agents.forEach((agent, i) => Object.assign(agent, { attacks: false, from: null, still: this.log.agents[i].still }));
    this.steps = 0;
    this.owed = 0;
    this.outcome = null;
    this.put(seen);
    document.body.classList.toggle("waits", !script);
    $("outcome").replaceChildren();
    this.going = Boolean(script);
    this.touch();
  }

  get key() {
    const criticality = this.network ? `&criticality=${$("criticality").value}` : "";
    return `scene=${$("scene").value}&traffic=${$("traffic").value}${criticality}`;
  }

  get link() {
    return `${location.href.split("#")[0]}#${this.key}&drive=${written(this.keys)}`;
  }

  /** Let the trained ego drive the same world, in its own worker. */
  async race(key) {
    const config = this.config(`${$("traffic").value}_trained`);
    const found = await this.rivals.ask("rival", { config, held: SETTINGS.held });
    if (this.key !== key) return;
    this.result = found;
    if (this.outcome) this.showCard();
    this.touch();
  }

  /** The same keys at criticality 0, in the other worker. */
  async relent() {
    const { turn, network } = this, run = this.runs[0];
    if (!network || +$("criticality").value === 0) return;
    const config = this.config($("traffic").value, 0);
    const { states, info } = await this.rivals.ask("again", { config, keys: this.keys });
    if (turn !== this.turn) return;
    const calm = emptied(run), last = states.length - 1;
    states.forEach((of, step) => write(calm, step, of));
    const { text, tone } = this.fate(calm, last, this.named(info));
    const then = last > this.keys.length ? ", then along the way" : "";
    this.calm = { run: calm, tone, text: `${CALM}${then}: ${text.replace("ego ", "you ").replace("its", "your")}` };
    this.showCard();
  }

  /** Outlines of others: the trained ego; of a drive that has ended, who met and where they are at criticality 0. */
  ghosts() {
    const run = this.runs[0], step = run.stepAt(this.time), { calm, result } = this, [ego] = run.agents;
    if (this.outcome && calm) {
      const partner = run.events[0]?.partner, on = calm.run.stepAt(this.slow ?? this.time);
      const of = (agent) => () => calm.run.pose(agent, on);
      const other = partner > 0 ? [[run.agents[partner].kind === "vehicle" ? this.network : "replay", of(partner), run.agents[partner]]] : [];
      return [["ego", of(0), ego], ...other];
    }
    if (!result) return [];
    const at = Math.min(Math.round(step), result.track.length / STATE - 1) * STATE;
    const [x, y, heading] = result.track.slice(at, at + 3);
    return [["ego", () => ({ x, y, heading }), ego]];
  }

  /** Write the present states into the run. */
  put({ states, info, plan, done }) {
    const run = this.runs[0], { network } = this, { policies, drivers } = this.settings;
    write(run, this.steps, states);
    run.agents.forEach((agent, i) => {
      const [x, y, , , , there, driver, guided] = states.subarray(i * STATE, (i + 1) * STATE);
      // parked until it moves, whatever it does in the log
      if (there && Math.hypot(x - (agent.from ??= [x, y])[0], y - agent.from[1]) > LOOK.PARKED_M) agent.still = false;
      agent.attacks ||= guided > 0;
      agent.driver = driver < 0 ? "ego" : agent.attacks ? "adversary" : policies[driver] || network;
      agent.drivenBy = driver < 0 ? "you" : drivers[agent.driver];
    });
    const made = planOf(plan, run);
    if (made && made.made_at !== run.plans.at(-1)?.made_at) run.plans.push(made);
    this.time = run.start + this.steps * run.dt;
    this.done = done;
    this.info = this.named(info);
  }

  named(info) {
    return Object.fromEntries(this.settings.columns.map((name, i) => [name, info[i]]));
  }

  /** One step of the world with the keys that are held. */
  async advance(held) {
    const turn = this.turn, seen = await this.engine.ask("step", held);
    if (turn !== this.turn) return;
    this.steps += 1;
    this.put(seen);
    if (this.done) this.finish();
    this.touch();
  }

  /** What became of a run that ended at a step, in words; its events are written into it. */
  fate(run, last, info) {
    const { settings } = this, at = ` at ${(last * run.dt).toFixed(1)} s`;
    if (info.collision) {
      const partner = info.collision_partner - 1; // 0 is nobody
      const [did, speed] = collisionOf(run, last, partner, settings), text = `ego ${did}${at}, ${speed.toFixed(1)} m/s`;
      run.events = [{ kind: "collision", step: last, agent: 0, partner, lane: "ego", text }];
      return { tone: "bad", text, fault: settings.words.fault[+(info.at_fault > 0)] };
    }
    if (info.off_road) return { tone: "bad", text: `ego ${settings.words.off_road}${at}`, fault: "" };
    if (info.goal_reached) {
      run.goal = { agent: 0, step: last }; // it stays to be seen
      return { tone: "good", text: `ego ${settings.words.goal}${at}`, fault: "" };
    }
    const [tone, what] = endOf(run, this.log, last, info, settings);
    return { tone, text: `ego ${what}`, fault: "" };
  }

  finish() {
    const run = this.runs[0];
    this.outcome = this.fate(run, this.steps, this.info);
    this.best = run.goal && this.score.keep(this.key, this.steps * run.dt);
    this.going = false;
    this.ended = this.time;
    this.slow = matchMedia("(prefers-reduced-motion)").matches ? null : Math.max(this.time - REPLAY_SECONDS, run.start);
    if (run.events.length) { // why: the plan of the other one, and the arrow to the ego
      run.plans = plansOf(run.plans, run.events[0].partner);
      Object.assign(this.layers, { plans: true, graph: true });
    }
    this.showCard();
    this.relent();
    $("outcome").replaceChildren(...verdict(this.outcome));
  }

  showCard() {
    const { result } = this;
    let line = "still driving";
    if (result) {
      const { words } = this.settings, info = this.named(result.info);
      const seconds = (result.track.length / STATE - 1) * this.runs[0].dt;
      const end = info.collision ? words.collided : info.off_road ? words.off_road : info.goal_reached ? words.goal : null;
      line = end ? `${end} at ${seconds.toFixed(1)} s` : wayOf(info, seconds, this.settings);
    }
    $("verdict").replaceChildren(...verdict(this.outcome));
    $("calm").textContent = this.calm ? this.calm.text : "";
    $("calm").className = `verdict ${this.calm?.tone}`;
    $("rival").textContent = `Trained ego: ${line}${this.score.said(this.key)}`;
    $("card").hidden = false;
  }

  /** The end as a picture, with what is said of it below. */
  picture() {
    this.time = this.ended;
    this.draw();
    const { canvas, width } = this.panes[0], ratio = canvas.width / width, image = document.createElement("canvas");
    const lines = [this.outcome.text, $("calm").textContent].filter(Boolean), colours = COLOURS[this.theme];
    Object.assign(image, { width: canvas.width, height: canvas.height + (16 + 22 * lines.length) * ratio });
    const context = image.getContext("2d");
    context.fillStyle = colours.paper;
    context.fillRect(0, 0, image.width, image.height);
    context.drawImage(canvas, 0, 0);
    context.fillStyle = colours.ink;
    lines.forEach((line, i) => {
      context.font = `${i ? 400 : 700} ${Math.min(15, width / 36) * ratio}px system-ui, sans-serif`;
      context.fillText(line, 14 * ratio, canvas.height + (26 + 22 * i) * ratio, image.width - 28 * ratio);
    });
    return new Promise((done) => {
      image.toBlob((blob) => done(new File([blob], `${$("scene").value}.png`, { type: blob.type })));
    });
  }

  hold(key, down) {
    if (down) this.held.add(key);
    else this.held.delete(key);
    if (down) this.roll();
    document.querySelectorAll("#pad button").forEach((button) =>
      button.classList.toggle("held", this.held.has(button.dataset.key)));
  }

  /** Begin to roll. */
  roll() {
    if (this.going || this.outcome || !this.runs.length || this.script) return;
    this.going = true;
    document.body.classList.remove("waits");
  }

  pause() {
    if (this.outcome) return;
    this.going = !this.going;
    document.body.classList.toggle("waits", !this.going);
  }

  /** Keys of the next step as one number: those held, or those of the link. */
  get mask() {
    if (this.script) return this.script[this.steps] || 0;
    return KEYS.reduce((sum, key, bit) => sum + (this.held.has(key) << bit), 0);
  }

  async go() {
    this.asked = true;
    const { mask, turn } = this;
    this.keys.push(mask);
    await this.advance(mask);
    if (turn !== this.turn) return;
    this.asked = false;
    if (this.script && this.steps >= this.script.length && !this.outcome) this.going = false;
  }

  move(elapsed) {
    if (document.body.classList.contains("waits") && !this.steps && this.headingUp && !$("help").open) {
      this.left -= elapsed;
      if (this.left < 0) this.roll();
    }
    if (this.going) {
      this.owed = Math.min(this.owed + elapsed, 3 * STEP_SECONDS);
      if (this.owed >= STEP_SECONDS && !this.asked) {
        this.owed -= STEP_SECONDS;
        this.go();
      }
      // drawn one step late, so that there is a state before and one after
      const run = this.runs[0];
      if (this.going) this.time = run.start + Math.max(this.steps - 1 + Math.min(this.owed / STEP_SECONDS, 1), 0) * run.dt;
      this.touch();
    }
    if (this.outcome && this.slow !== null) { // the end again, slowly, as often as one likes
      this.slow += elapsed * REPLAY_RATE;
      if (this.slow > this.ended + (this.calm ? ON_SECONDS : STILL_SECONDS)) this.slow = Math.max(this.ended - REPLAY_SECONDS, this.runs[0].start);
      this.time = Math.min(this.slow, this.ended);
      this.touch();
    }
  }

  draw() {
    if (!this.info) return; // no scene is open
    const run = this.runs[0], pane = this.panes[0], pose = run.pose(0, run.stepAt(this.time));
    if (pose) {
      this.camera.right = this.headingUp ? pose.heading - Math.PI / 2 : 0;
      // more of the road ahead than of that behind; on a phone the card lies below what it is about
      const low = this.outcome && innerWidth <= 760 ? -0.2 : 0.18;
      const ahead = this.headingUp ? low * pane.height / this.camera.scale : 0;
      this.camera.x = pose.x + ahead * Math.cos(pose.heading);
      this.camera.y = pose.y + ahead * Math.sin(pose.heading);
    }
    pane.ground.ghosts = this.ghosts();
    pane.draw(this);
    showLegend(this);
    const speed = Math.hypot(run.a.vx[this.steps], run.a.vy[this.steps]);
    $("figures").textContent = `${(this.steps * run.dt).toFixed(1)} s · ${speed.toFixed(1)} m/s · `
      + `${Math.floor(100 * this.info.route_completion)} % of the way${this.score.said(this.key)}`;
    $("heading").setAttribute("aria-pressed", this.headingUp);
  }
}

const plainKey = ({ key }) => (key.length === 1 ? key.toLowerCase() : key);

function wire(drive) {
  const names = [...document.querySelectorAll("script.run")].map((node) => node.dataset.scene);
  for (const name of names) $("scene").append(new Option(name, name));
  for (const [name, title] of Object.entries(drive.settings.traffic)) $("traffic").append(new Option(title, name));
  const asked = new URLSearchParams(location.hash.slice(1));
  const absent = ["scene", "traffic"].filter((id) => {
    const offered = [...$(id).options].some(({ value }) => value === asked.get(id));
    if (offered) $(id).value = asked.get(id);
    return asked.has(id) && !offered;
  });
  if (asked.has("criticality")) $("criticality").value = asked.get("criticality");
  const opened = () => {
    try { history.replaceState(null, "", `#${drive.key}`); } catch { /* inside another page */ }
    document.activeElement.blur();
    return drive.open($("scene").value);
  };
  const levelled = () => {
    $("level").textContent = $("criticality").value;
    $("level").closest("label").hidden = !drive.network;
  };
  levelled();
  $("criticality").addEventListener("input", levelled);
  $("traffic").addEventListener("change", levelled);
  for (const id of ["scene", "traffic", "criticality"]) $(id).addEventListener("change", opened);
  $("copy").addEventListener("click", async () => {
    let said = "Link copied";
    try {
      if (matchMedia("(pointer: coarse)").matches && navigator.share) {
        const files = [await drive.picture()], also = navigator.canShare?.({ files }) ? { files } : {};
        await navigator.share({ title: `${drive.outcome.text} (${$("scene").value})`, url: drive.link, ...also });
        said = "Shared";
      } else await navigator.clipboard.writeText(drive.link);
    } catch { said = "Copy the address"; }
    try { history.replaceState(null, "", new URL(drive.link).hash); } catch { /* inside another page */ }
    $("copy").textContent = said;
    setTimeout(() => { $("copy").textContent = "Share this drive"; }, 2000);
  });
  $("picture").addEventListener("click", async () => {
    const file = await drive.picture(), link = element("a");
    Object.assign(link, { href: URL.createObjectURL(file), download: file.name }).click();
    URL.revokeObjectURL(link.href);
  });
  wireKeys(drive, [
    ["← → A D", "steer"], ["↓ S", "brake"], ["↑ W", "go faster"],
    ["R", "begin again", { r: () => drive.begin() }],
    ["N", "next scene", { n: () => {
      $("scene").selectedIndex = ($("scene").selectedIndex + 1) % names.length;
      opened();
    } }],
    ["P, space", "pause", { p: () => drive.pause(), " ": () => drive.pause() }],
    ["H", "heading up", { h: () => { drive.headingUp = !drive.headingUp; } }],
    ["T", "dark or light", { t: () => setTheme(drive) }],
    ...SHARED_KEYS,
  ]);
  addEventListener("keydown", (event) => {
    const driven = DRIVE_KEYS[plainKey(event)];
    if (!driven || !forMap(event)) return;
    event.preventDefault();
    drive.hold(driven, true);
  });
  addEventListener("keyup", (event) => {
    const driven = DRIVE_KEYS[plainKey(event)];
    if (driven) drive.hold(driven, false);
  });
  addEventListener("blur", () => [...drive.held].forEach((key) => drive.hold(key, false)));
  for (const button of document.querySelectorAll("#pad button")) {
    const set = (down) => (event) => {
      event.preventDefault();
      drive.hold(button.dataset.key, down);
    };
    button.addEventListener("pointerdown", set(true));
    for (const end of ["pointerup", "pointercancel", "pointerleave"]) button.addEventListener(end, set(false));
    button.addEventListener("contextmenu", (event) => event.preventDefault());
    button.addEventListener("keydown", (event) => { if (event.key === "Enter" || event.key === " ") set(true)(event); });
    button.addEventListener("keyup", set(false));
  }
  new ResizeObserver(() => drive.touch()).observe($("app"));
  const script = asked.has("drive") ? read(asked.get("drive")) : null;
  return opened().then(() => {
    if (!absent.length) return script && drive.begin(script);
    const text = absent.map((id) => `no ${id} ${asked.get(id)} on this page`).join(", ");
    $("outcome").replaceChildren(...verdict({ tone: "bad", text: text + (script ? ": give the link to ccdiff-env view" : "") }));
  });
}

async function main() {
  const kept = [$("module"), $("ego"), ...document.querySelectorAll("script.weights")];
  const bytes = await Promise.all(kept.map(async (node) => new Uint8Array(await inflate(node))));
  const [module, trained, ...weights] = bytes, source = $("engine").textContent;
  const engines = [new Engine(source), new Engine(source)];
  await Promise.all(engines.map((e) => e.ask("open", { module, weights, trained, columns: SETTINGS.columns.length })));
  const drive = new Drive(...engines);
  setTheme(drive, matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
  await wire(drive);
  window.drive = drive; // for the curious, and for tests
}

start(main, (why) => `The playground cannot run here: the browser is too old, or blocks WebAssembly (${why}).`);
