// Start of the page: reads the runs, wires buttons, keys and panels to the player.

const CHROME = {};
function chromeOf({ theme }) {
  const style = getComputedStyle(document.documentElement), of = (name) => style.getPropertyValue(`--${name}`);
  const { collision, goal, ink, "road divider": off_road } = COLOURS[theme];
  return CHROME[theme] ??= {
    track: of("line"), accent: of("accent"), panel: of("panel"), faint: of("quiet"),
    flags: { collision, goal, off_road, blocked: of("warn"), plan: goal, other: ink },
  };
}

const PANEL_MS = 80; // panels change no faster than this while playing
const LAYER_TITLES = {
  trails: ["Trails", "T"], plans: ["Plans", "P"], graph: ["Causal graph", "G"], labels: ["Names", "L"],
  lanes: ["Lanes", "K"],
};
const second = (player) => Math.round(1 / player.step);
const layer = (name) => (p) => p.toggle(name);
/** What the help says of keys, and what each does with the player and the event. */
const KEYS = [
  ["space", "play, pause", { " ": (p) => p.togglePlay() }],
  ["← →", "one step back, forward", {
    ArrowLeft: (p, e) => p.stepBy(e.shiftKey ? -second(p) : -1), ArrowRight: (p, e) => p.stepBy(e.shiftKey ? second(p) : 1) }],
  ["shift ← →", "one second back, forward", {}],
  ["home, end", "first, last step", { Home: (p) => p.seek(p.start), End: (p) => p.seek(p.end) }],
  ["E", "follow the ego", { e: (p) => p.followAgent(p.runs[0].agents[0].id) }],
  ["F", "show all, follow nobody", { f: (p) => p.fit() }],
  ["H", "heading up", { h: (p) => p.headUp(!p.headingUp) }],
  ["T P G", "trails, plans, causal graph", { t: layer("trails"), p: layer("plans"), g: layer("graph") }],
  ["L K", "names, lanes", { l: layer("labels"), k: layer("lanes") }],
  ["1 2 …, 0", "one run alone, all runs", { 0: (p) => p.slid || p.show(null) }],
  ["D", "dark or light", { d: (p) => setTheme(p) }],
  ["S", "panels", { s: () => document.body.classList.toggle("bare") }],
  ...SHARED_KEYS,
];

async function main() {
  const runs = [];
  for (const node of document.querySelectorAll("script.run")) runs.push(await readRun(node));

  const player = new Player(runs, $("stage"), () => update());
  const seek = (time) => { player.playing = false; player.seek(time); };
  const timeline = new Timeline($("timeline"), runs, seek);
  const strip = new Strip($("strip"), $("figure"), timeline);
  $("figure").addEventListener("change", () => player.touch());
  player.showing = () => {
    timeline.runs = player.told;
    showEvents($("events"), player.told, (run, event) => player.goTo(run, event));
  };
  player.showing();
  if (runs.length === 1) $("outcome").append(...verdict(runs[0].outcome));
  document.body.classList.toggle("compare", runs.length > 1);
  document.body.classList.toggle("many", runs.length > 2);
  let shown = 0;
  const update = () => {
    const chrome = chromeOf(player), now = performance.now();
    timeline.draw(player.time, chrome);
    strip.draw(player, chrome);
    $("time").textContent = (player.time - player.start).toFixed(1);
    if (player.playing && now - shown < PANEL_MS) return;
    shown = now;
    timeline.speak(player.time);
    showFocus(player);
    showControls(player);
    showLegend(player);
  };
  wireControls(player);
  if (SETTINGS.slider) wireSlider(player);
  const alone = {};
  if (runs.length > 1)
    player.panes.slice(0, 9).forEach((_, index) => {
      alone[index + 1] = () => { player.show(index, Boolean(player.slid)); player.slid?.(); };
    });
  wireKeys(player, KEYS, alone);
  player.panes.forEach((pane, index) => {
    wirePane(pane, player);
    pane.enlarge.addEventListener("click", () => player.show(index));
  });
  setTheme(player, matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
  player.frameNeighbours();
  const asked = readAddress(player);
  addEventListener("hashchange", () => readAddress(player));
  let known = addressOf(player); // as opened: the address stays as it came until something changes
  setInterval(() => { known = writeAddress(player, known); }, 500);
  player.playing = asked.has("t") ? asked.has("play") : !matchMedia("(prefers-reduced-motion)").matches;
  const sizes = new ResizeObserver(() => player.touch());
  for (const pane of player.panes) sizes.observe(pane.canvas);
  window.replay = player; // for the curious, and for tests
}

/**
 * What the address asks for: page.html#t=4.2&follow=1&show=graph (t in seconds from the
 * start), also hide=trails, run=2 (that run alone), play=1, up=heading or up=north.
 */
function readAddress(player) {
  const wishes = new URLSearchParams(location.hash.slice(1));
  if (wishes.has("t")) player.seek(player.start + (Number(wishes.get("t")) || 0));
  const name = wishes.get("follow"), agents = player.runs.flatMap((run) => run.agents);
  const found = agents.find(({ id }) => id === name) || agents.find(({ label }) => label === name);
  if (found) player.followAgent(found.id);
  for (const [word, wanted] of [["show", true], ["hide", false]])
    for (const layer of (wishes.get(word) || "").split(","))
      if (LAYERS.includes(layer)) player.layers[layer] = wanted;
  const run = Number(wishes.get("run")) - 1; // none: NaN
  if (player.panes[run] && run !== player.alone) { player.show(run); player.slid?.(); }
  if (wishes.has("up")) player.headUp(wishes.get("up") === "heading");
  player.touch();
  return wishes;
}

function addressOf(player) {
  const wishes = new URLSearchParams({ t: (player.time - player.start).toFixed(1) });
  if (player.follow !== null) wishes.set("follow", player.follow);
  for (const [word, wanted] of [["show", true], ["hide", false]]) {
    const changed = LAYERS.filter((layer) => player.layers[layer] === wanted && LAYERS_AT_START[layer] !== wanted);
    if (changed.length) wishes.set(word, changed.join());
  }
  if (player.alone !== null) wishes.set("run", player.alone + 1);
  wishes.set("up", player.headingUp ? "heading" : "north");
  return `#${wishes.toString().replaceAll("%2C", ",")}`;
}

/** The address bar follows while nothing plays. Returns the address that it now stands for. */
function writeAddress(player, known) {
  const hash = addressOf(player);
  if (player.playing || hash === known) return known;
  try { history.replaceState(null, "", hash); } catch { return known; } // a page inside another one
  return hash;
}

function wireControls(player) {
  $("events-part").hidden = player.runs.every((run) => !run.events.length);
  for (const rate of RATES) $("rate").append(new Option(`${rate}×`, rate));
  $("rate").addEventListener("change", () => { player.rate = +$("rate").value; });
  $("follow").append(new Option("nobody", ""));
  for (const agent of player.runs[0].agents)
    if (agent.kind !== "static") $("follow").append(new Option(agent.title, agent.id));
  $("follow").addEventListener("change", () => player.followAgent($("follow").value || null));
  $("help").addEventListener("click", (event) => { if (event.target === $("help")) $("help").close(); });
  for (const layer of LAYERS) {
    if (layer === "plans" && player.runs.every((run) => !run.plans.length && !run.intentions.length)) continue;
    const [title, key] = LAYER_TITLES[layer];
    const chip = element("button", "chip", title);
    chip.id = `layer-${layer}`;
    chip.title = `${title} (${key})`;
    chip.addEventListener("click", () => player.toggle(layer));
    $("layers").append(chip);
  }
}

/** One run at a time, chosen by a slider while it plays; marks below it are what became of the ego in each. */
function wireSlider(player) {
  const [input, output, dots] = ["input", "output", ".dots"].map((part) => $("choice").querySelector(part));
  input.max = player.runs.length - 1;
  for (const { title, outcome: { tone, text } } of player.runs) {
    const dot = element("i", tone);
    dot.title = `${title}: ${text}`;
    dots.append(dot);
  }
  const choose = () => {
    player.show(+input.value, true);
    output.textContent = player.shown.run.title;
    input.setAttribute("aria-valuetext", `${output.textContent}: ${player.shown.run.outcome.text}`);
  };
  player.slid = () => { input.value = player.alone; choose(); };
  input.addEventListener("input", choose);
  $("choice").hidden = false;
  document.body.classList.add("sliding");
  choose();
}

function showControls(player) {
  $("play").textContent = player.playing ? "❚❚" : "▶";
  $("play").setAttribute("aria-label", player.playing ? "pause" : "play");
  $("length").textContent = ` / ${(player.end - player.start).toFixed(1)} s`;
  $("rate").value = player.rate;
  $("follow").value = player.follow === null ? "" : player.follow;
  const layers = LAYERS.map((layer) => [`layer-${layer}`, player.layers[layer]]);
  for (const [id, on] of [["heading", player.headingUp], ...layers])
    $(id)?.setAttribute("aria-pressed", on);
}

/** Captions of the chosen agent; where two runs say different things, both stand there. */
function showFocus(player) {
  const list = $("captions");
  const knowing = player.told.filter((run) => run.indexOf.has(player.focus));
  if (!knowing.length) {
    list.replaceChildren(element("p", "quiet", "Click an agent to select it."));
    return;
  }
  const known = knowing.map((run) => {
    const agent = run.indexOf.get(player.focus);
    return new Map(captionsOf(run, agent, player.time));
  });
  const names = [...new Set(known.flatMap((captions) => [...captions.keys()]))];
  const rows = names.map((name) => {
    const values = known.map((captions) => captions.get(name) || "–");
    return [name, ...(values.every((value) => value === values[0]) ? [values[0]] : values)];
  });
  const marks = knowing.map((run) => player.runs.indexOf(run));
  const run = knowing[0];
  showCaptions(list, run.agents[run.indexOf.get(player.focus)].title, rows, marks);
}

function wirePane(pane, player) {
  listenToGestures(pane.canvas, {
    drag(dx, dy) {
      player.follow = null;
      player.camera.pan(dx, dy);
      player.touch();
    },
    zoom(factor, x, y) {
      player.camera.zoom(factor, x, y, pane.width, pane.height, player.follow !== null);
      player.touch();
    },
    tap(x, y) {
      player.choose(pane.find(player.camera, x, y, player.time, 14));
    },
  });
}

start(main, (why) => `This replay cannot be shown: its data are damaged, or the browser is too old (${why}). `
  + "Write the page again with ccdiff-env view.");
