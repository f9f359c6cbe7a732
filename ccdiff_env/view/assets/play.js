// The controls beside a replay: every change plays the scene again.

const form = document.getElementById("wishes"), frame = document.getElementById("frame");
const state = document.getElementById("state"), undo = document.getElementById("undo");
let moves = {}, waiting = 0, refused = []; // refused: what the address asks for and is not there

function play() {
  clearTimeout(waiting);
  waiting = setTimeout(() => {
    form.criticality.disabled = ![form.traffic.value, form.driver.value].includes("ccdiff");
    const words = new URLSearchParams(new FormData(form)); // without fields that are disabled
    if (Object.keys(moves).length) words.set("moves", JSON.stringify(moves));
    undo.hidden = !Object.keys(moves).length;
    state.textContent = "playing …";
    history.replaceState(null, "", `#${words}`);
    frame.src = `/replay?${words}`;
  }, 250);
}

/** The address may hold wishes: what was played last. */
function restore() {
  const words = new URLSearchParams(location.hash.slice(1));
  for (const [name, value] of words) {
    const field = form.elements[name];
    if (field?.type === "checkbox") field.checked = true;
    else if (field?.options && ![...field.options].some((option) => option.value === value))
      refused.push(`${name} ${value}`);
    else if (field) field.value = value;
  }
  try { moves = JSON.parse(words.get("moves") || "{}"); } catch { moves = {}; }
  showLevel();
}

function showLevel() {
  document.getElementById("level").textContent = form.criticality.value;
}

form.addEventListener("submit", (event) => { event.preventDefault(); play(); });
form.addEventListener("change", (event) => { if (event.target.name === "scene") moves = {}; play(); });
form.criticality.addEventListener("input", showLevel);
document.getElementById("next").addEventListener("click", () => { form.seed.value = +form.seed.value + 1; play(); });
undo.addEventListener("click", () => { moves = {}; play(); });
frame.addEventListener("load", () => {
  state.textContent = refused.length ? `there is no ${refused.join(", no ")}: this is ${form.scene.value}`
    : "drag an agent: press M in the replay";
  refused = [];
});
addEventListener("message", (event) => {
  if (event.source !== frame.contentWindow || event.origin !== location.origin) return;
  const { moved, east, north } = event.data;
  const [x, y] = moves[moved] || [0, 0];
  moves[moved] = [+(x + east).toFixed(2), +(y + north).toFixed(2)];
  play();
});
restore();
play();
