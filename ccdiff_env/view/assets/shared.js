// What replays and the playground share: theme, keys, legend, and what is said where nothing works.

const $ = (id) => document.getElementById(id);

/** Show a theme, by default the other one. */
function setTheme(player, theme = player.theme === "dark" ? "light" : "dark") {
  player.theme = theme;
  document.documentElement.dataset.theme = theme;
  player.touch();
}

/** Whether a key is meant for the map; a dialog that was just closed keeps the focus until the next frame. */
function forMap(event) {
  return !(event.ctrlKey || event.metaKey || event.altKey || $("help").open)
    && event.target.matches("body, .map, #timeline, #help *");
}

/** Wire keys and buttons by rows of the help: keys, what they do, and actions by key. */
function wireKeys(player, rows, also = {}) {
  const actions = Object.assign({}, ...rows.map(([, , keys]) => keys), also);
  $("keys").append(...rows.map(([key, what]) => {
    const row = element("div", "key");
    row.append(element("kbd", "", key), element("span", "", what));
    return row;
  }));
  const act = (key, event) => {
    const action = actions[key] || actions[key.toLowerCase()];
    action?.(player, event);
    player.touch();
    return action;
  };
  for (const button of document.querySelectorAll("[data-key]"))
    button.addEventListener("click", (event) => act(button.dataset.key, event));
  addEventListener("keydown", (event) => {
    if (event.repeat && !event.key.startsWith("Arrow")) return;
    if (forMap(event) && act(event.key, event)) event.preventDefault();
  });
  // paper is light
  let { theme } = player;
  addEventListener("beforeprint", () => {
    ({ theme } = player);
    setTheme(player, "light");
    player.draw();
  });
  addEventListener("afterprint", () => setTheme(player, theme));
  // a button that is clicked gives the keys back to the map
  addEventListener("click", (event) => {
    if (event.detail > 0 && event.target.closest("#app button")) document.activeElement.blur();
  });
}

const zoomed = (factor) => (player) => player.camera.zoom(factor, 0, 0, 0, 0, true);
/** Rows of the help that replays and the playground share. */
const SHARED_KEYS = [
  ["+ −", "zoom", { "+": zoomed(1.25), "=": zoomed(1.25), "-": zoomed(0.8) }],
  ["?", "this help", { "?": () => $("help").showModal() }],
];

/** Run the page; where it cannot, say why. */
function start(main, why) {
  main().then(() => { document.body.dataset.ready = "yes"; }, (error) => {
    document.body.dataset.ready = "failed";
    $("failure").hidden = false;
    $("failure").textContent = why(error.message);
    throw error;
  });
}

function showLegend(player) {
  const key = `${player.theme} ${player.layers.graph} ${player.runs[0]?.agents.map((a) => [a.driver, a.still])}`;
  if ($("legend").dataset.key === key) return;
  $("legend").dataset.key = key;
  $("legend").replaceChildren(...legendOf(player).map(([colour, title, hollow]) => {
    const item = element("span", "legend-item"), dot = element("i");
    item.setAttribute("role", "listitem");
    if (hollow) dot.style.boxShadow = `inset 0 0 0 1.5px ${colour}`;
    else dot.style.background = colour;
    item.append(dot, title);
    return item;
  }));
}

function legendOf(player) {
  const agents = player.runs.flatMap((run) => run.agents), colours = COLOURS[player.theme];
  const seen = new Set(agents.map((agent) => (agent.kind === "static" ? "static" : agent.driver)));
  const rows = Object.entries(SETTINGS.drivers).filter(([name]) => seen.has(name))
    .map(([name, title]) => [colours[name === "static" ? "static obstacle" : name], title]);
  if (agents.some(({ still, kind }) => still && kind === "vehicle"))
    rows.push([colours.ink, "parked", true]);
  if (player.layers.graph) rows.push([colours["causal arrow"], "may influence"]);
  return rows;
}
