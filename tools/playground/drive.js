// The playground: the world of the package as WebAssembly, drawn as replays are, driven by keys.

const STEP_SECONDS = 0.1, STATE = 7;
const STEER_PER_SECOND = 4; // from straight on to full lock in a quarter of a second
const DRIVE_KEYS = {
  ArrowUp: "gas", w: "gas", ArrowDown: "brake", s: "brake",
  ArrowLeft: "left", a: "left", ArrowRight: "right", d: "right",
};
const HELP = [
  ["↑ W", "accelerate"], ["↓ S", "brake"], ["← → A D", "steer"], ["R", "begin again"],
  ["N", "next scene"], ["P, space", "pause"], ["H", "heading up"], ["G", "outlines of the recording"],
  ["+ −", "zoom"], ["T", "dark or light"], ["?", "this help"],
];
const SIDES = ["", "collision_front", "collision_rear", "collision_side"];

/** The compiled module: scenes and worlds behind plain calls. */
class Engine {
  constructor(instance) {
    this.calls = instance.exports;
  }

  /** Bytes for the next call. */
  give(bytes) {
    const at = this.calls.room(bytes.length);
    new Uint8Array(this.calls.memory.buffer, at, bytes.length).set(bytes);
  }

  check(failed) {
    if (!failed) return;
    const { memory, message, message_length } = this.calls;
    const text = new Uint8Array(memory.buffer, message(), message_length());
    throw new Error(new TextDecoder().decode(text));
  }

  load(bytes) {
    this.give(bytes);
    this.check(this.calls.load());
  }

  reset(config) {
    this.give(new TextEncoder().encode(config));
    this.check(this.calls.reset(0));
  }

  step(action) {
    this.check(this.calls.step(...action));
  }

  /** Present states [A, 7], see rust/wasm. */
  get states() {
    const { memory, states, num_agents } = this.calls;
    return new Float32Array(memory.buffer, states(), num_agents() * STATE).slice();
  }

  columns(names) {
    const values = new Float32Array(this.calls.memory.buffer, this.calls.columns(), names.length);
    return Object.fromEntries(names.map((name, i) => [name, values[i]]));
  }

  get done() { return this.calls.done() === 1; }
}

/** The ground, and on it the way of the ego's log with a ring at its end. */
class Way extends Ground {
  constructor(run, log) {
    super(run);
    this.log = log;
  }

  draw(context, colours, pixel) {
    super.draw(context, colours, pixel);
    const { x, y } = this.log.a, last = this.log.numSteps - 1;
    context.strokeStyle = this.colour;
    context.lineCap = context.lineJoin = "round";
    context.globalAlpha = 0.28;
    context.lineWidth = Math.max(0.7, 3 * pixel);
    context.beginPath();
    for (let i = 0; i <= last; i++) context.lineTo(x[i], y[i]);
    context.stroke();
    context.globalAlpha = 1;
    context.lineWidth = Math.max(0.3, 2.5 * pixel);
    context.beginPath();
    context.arc(x[last], y[last], 2.2, 0, 2 * Math.PI);
    context.stroke();
  }
}

/** State of the page. It has what a pane and the legend ask a player for. */
class Drive {
  constructor(engine, settings) {
    Object.assign(this, { engine, settings });
    this.camera = new Camera();
    this.theme = "light";
    this.colourMode = "driver";
    this.layers = { trails: true, plans: false, graph: false, labels: true, lanes: true, ghost: false };
    this.headingUp = !matchMedia("(prefers-reduced-motion)").matches;
    this.focus = "ego";
    this.hover = this.pair = this.carried = null;
    this.held = new Set();
    this.panes = this.runs = [];
    this.time = this.before = 0;
    this.colours = settings.colours;
    requestAnimationFrame((now) => this.frame(now));
  }

  touch() { this.dirty = true; }

  /** Take a scene and begin. */
  async open(name) {
    const of = (kind) => document.querySelector(`script.${kind}[data-scene="${CSS.escape(name)}"]`);
    const [run, log, bytes] = await Promise.all([readRun(of("run")), readRun(of("run")), inflate(of("bytes"))]);
    this.engine.load(new Uint8Array(bytes));
    this.runs = [run];
    this.log = log;
    $("stage").querySelectorAll(".pane").forEach((pane) => pane.remove());
    run.title = name;
    run.outcome = { tone: "plain", text: "driven by keys", others: 0 };
    this.panes = [new Pane($("stage"), run, 0, this.colours)];
    this.panes[0].ground = new Way(run, log);
    this.panes[0].root.append(element("p", "pane-note hint", "Press ↑ or touch ▲ to drive"));
    this.recording = new Actors(log, this.colours);
    wireMap(this.panes[0], this);
    this.camera.scale = Math.max(Math.min(this.panes[0].width, this.panes[0].height) / 75, 5);
    this.begin();
  }

  /** Begin the scene again. */
  begin() {
    this.engine.reset(this.settings.configs[$("traffic").value]);
    const run = this.runs[0];
    run.a.valid.fill(0);
    run.a.pairStart.fill(0);
    run.events = [];
    run.isLog = false;
    this.steps = 0;
    this.reward = 0;
    this.steer = 0;
    this.owed = 0;
    this.going = false;
    this.outcome = null;
    this.put();
    document.body.classList.add("waits");
    $("outcome").replaceChildren();
    this.touch();
  }

  /** Write the present states into the run. */
  put() {
    const run = this.runs[0], { states } = this.engine, { policies, drivers } = this.settings;
    run.agents.forEach((agent, i) => {
      const [x, y, heading, vx, vy, there, driver] = states.subarray(i * STATE, (i + 1) * STATE);
      const at = i * run.numSteps + this.steps;
      Object.entries({ x, y, heading, vx, vy }).forEach(([name, value]) => { run.a[name][at] = value; });
      run.a.valid[at] = there;
      agent.driver = driver < 0 ? "ego" : policies[driver];
      agent.drivenBy = driver < 0 ? "you" : drivers[agent.driver];
    });
    this.time = run.start + this.steps * run.dt;
    this.info = this.engine.columns(this.settings.columns);
  }

  /** One step of the world with a normalised action: acceleration and yaw rate. */
  advance(action) {
    this.engine.step(action);
    this.steps += 1;
    this.put();
    const { settings, info } = this;
    this.reward += settings.columns.filter((name) => name.startsWith("reward_"))
      .reduce((sum, name) => sum + info[name], 0);
    if (this.engine.done) this.finish();
    this.touch();
  }

  /** What became of the episode. */
  finish() {
    const run = this.runs[0], { info, settings } = this, seconds = (this.steps * run.dt).toFixed(1);
    const partner = info.collision_partner - 1; // 0 is nobody
    let tone = "bad", text;
    if (info.collision) {
      const other = run.agents[partner];
      const side = other && other.kind === "static" ? "static" : SIDES[info.collision_kind];
      const words = (settings.collisions[side] || "{one} and {other} touch").replace("{one}", "ego");
      const fault = info.at_fault ? "at fault" : "not at fault";
      text = `${words.replace("{other}", other ? other.title.replace(" · ", " (") + ")" : "someone")} at ${seconds} s, ${fault}`;
      run.events.push({ kind: "collision", step: this.steps, agent: 0, partner, lane: "ego", text });
    } else if (info.off_road) {
      text = `ego left the road at ${seconds} s`;
    } else if (info.goal_reached) {
      [tone, text] = ["good", `ego reached its goal at ${seconds} s`];
    } else {
      [tone, text] = ["plain", `ego not at its goal in ${seconds} s`];
    }
    this.outcome = { tone, text };
    this.going = false;
    $("outcome").replaceChildren(...verdict(this.outcome));
    $("said").textContent = text;
  }

  /** A key or a button of the pad goes down or up. */
  hold(key, down) {
    if (down) this.held.add(key);
    else this.held.delete(key);
    if (down && !this.going && !this.outcome && this.runs.length) {
      this.going = true;
      document.body.classList.remove("waits");
    }
    document.querySelectorAll("#pad button").forEach((button) =>
      button.classList.toggle("held", this.held.has(button.dataset.key)));
  }

  pause() {
    if (this.outcome) return;
    this.going = !this.going;
    document.body.classList.toggle("waits", !this.going);
  }

  /** What the keys that are held ask for. */
  action() {
    const wanted = this.held.has("left") - this.held.has("right"), most = STEER_PER_SECOND * STEP_SECONDS;
    this.steer += Math.min(Math.max(wanted - this.steer, -most), most);
    return [this.held.has("brake") ? -1 : +this.held.has("gas"), this.steer];
  }

  frame(now) {
    const elapsed = Math.min((now - this.before) / 1000, 0.1);
    this.before = now;
    if (this.going) {
      this.owed += elapsed;
      while (this.owed >= STEP_SECONDS && this.going) {
        this.owed -= STEP_SECONDS;
        this.advance(this.action());
      }
      // drawn one step late, so that there is a state before and one after
      const run = this.runs[0];
      if (this.going) this.time = run.start + Math.max(this.steps - 1 + this.owed / STEP_SECONDS, 0) * run.dt;
      this.dirty = true;
    }
    if (this.dirty && this.panes.length) {
      this.dirty = false;
      this.draw();
    }
    requestAnimationFrame((next) => this.frame(next));
  }

  draw() {
    const run = this.runs[0], pane = this.panes[0], pose = run.pose(0, run.stepAt(this.time));
    if (pose) {
      this.camera.right = this.headingUp ? pose.heading - Math.PI / 2 : 0;
      // more of the road ahead than of that behind
      const ahead = this.headingUp ? 0.18 * pane.height / this.camera.scale : 0;
      this.camera.x = pose.x + ahead * Math.cos(pose.heading);
      this.camera.y = pose.y + ahead * Math.sin(pose.heading);
    }
    pane.ground.colour = this.colours[this.theme].ego;
    pane.draw(this, { actors: this.recording, run: this.log });
    showLegend(this, this.settings);
    const speed = Math.hypot(run.a.vx[this.steps], run.a.vy[this.steps]);
    $("figures").textContent = `${(this.steps * run.dt).toFixed(1)} s · ${speed.toFixed(1)} m/s · `
      + `${Math.floor(100 * this.info.route_completion)} % of the way · return ${this.reward.toFixed(1)}`;
    $("heading").setAttribute("aria-pressed", this.headingUp);
    $("ghost").setAttribute("aria-pressed", this.layers.ghost);
  }
}

function wireMap(pane, drive) {
  const nothing = () => {};
  listenToGestures(pane.canvas, {
    grab: () => false, carry: nothing, drop: nothing, drag: nothing, hover: nothing, tap: nothing, doubleTap: nothing,
    zoom(factor, x, y) {
      drive.camera.zoom(factor, x, y, pane.width, pane.height, true);
      drive.touch();
    },
  });
}

function wire(drive) {
  const names = [...document.querySelectorAll("script.run")].map((node) => node.dataset.scene);
  for (const name of names) $("scene").append(new Option(name, name));
  for (const [name, title] of Object.entries(drive.settings.traffic)) $("traffic").append(new Option(title, name));
  const asked = new URLSearchParams(location.hash.slice(1));
  if (names.includes(asked.get("scene"))) $("scene").value = asked.get("scene");
  if (asked.get("traffic") in drive.settings.traffic) $("traffic").value = asked.get("traffic");
  const opened = () => {
    try { history.replaceState(null, "", `#scene=${$("scene").value}&traffic=${$("traffic").value}`); } catch { /* inside another page */ }
    document.activeElement.blur();
    return drive.open($("scene").value);
  };
  $("scene").addEventListener("change", opened);
  $("traffic").addEventListener("change", opened);
  const toggle = { heading: () => { drive.headingUp = !drive.headingUp; }, ghost: () => { drive.layers.ghost = !drive.layers.ghost; } };
  const actions = {
    r: () => drive.begin(),
    n: () => {
      $("scene").selectedIndex = ($("scene").selectedIndex + 1) % names.length;
      opened();
    },
    p: () => drive.pause(), " ": () => drive.pause(),
    h: toggle.heading, g: toggle.ghost,
    t: () => setTheme(drive, drive.theme === "dark" ? "light" : "dark"),
    "+": () => drive.camera.zoom(1.25, 0, 0, 0, 0, true), "=": () => drive.camera.zoom(1.25, 0, 0, 0, 0, true),
    "-": () => drive.camera.zoom(0.8, 0, 0, 0, 0, true),
    "?": () => $("help").showModal(),
  };
  for (const [id, key] of [["reset", "r"], ["heading", "h"], ["ghost", "g"], ["theme", "t"], ["help-button", "?"]])
    $(id).addEventListener("click", (event) => {
      actions[key]();
      drive.touch();
      if (event.detail > 0 && key !== "?") document.activeElement.blur();
    });
  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || $("help").open) return;
    if (!event.target.matches("body, .map, #help *")) return;
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key, driven = DRIVE_KEYS[key];
    if (!driven && !actions[key]) return;
    event.preventDefault();
    if (driven) drive.hold(driven, true);
    else if (!event.repeat) actions[key]();
    drive.touch();
  });
  addEventListener("keyup", (event) => {
    const driven = DRIVE_KEYS[event.key.length === 1 ? event.key.toLowerCase() : event.key];
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
  for (const [key, what] of HELP) {
    const row = element("div", "key");
    row.append(element("kbd", "", key), element("span", "", what));
    $("keys").append(row);
  }
  new ResizeObserver(() => drive.touch()).observe($("app"));
  return opened();
}

async function main() {
  const settings = JSON.parse($("settings").textContent);
  const { instance } = await WebAssembly.instantiate(await inflate($("module")), {});
  const drive = new Drive(new Engine(instance), settings);
  setTheme(drive, matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
  await wire(drive);
  window.drive = drive; // for the curious, and for tests
  document.body.dataset.ready = "yes";
}

main().catch((error) => {
  document.body.dataset.ready = "failed";
  $("failure").hidden = false;
  $("failure").textContent = `The playground cannot run here: the browser is too old, or blocks WebAssembly (${error.message}).`;
  throw error;
});
