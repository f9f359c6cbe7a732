// The worker: worlds of the package as WebAssembly, and the trained ego that drives the same scene ahead.

const STATE = 8;
let calls, columns;

function give(bytes) {
  const at = calls.room(bytes.length);
  new Uint8Array(calls.memory.buffer, at, bytes.length).set(bytes);
}

function check(failed) {
  if (failed) throw new Error(new TextDecoder().decode(new Uint8Array(calls.memory.buffer, calls.message(), calls.message_length())));
}

const floats = (at, length) => new Float32Array(calls.memory.buffer, at, length);

/** States [A, 8], see rust/wasm, figures of the step, and whether it was the last. */
function now() {
  return { states: floats(calls.states(), calls.num_agents() * STATE).slice(), info: floats(calls.columns(), columns).slice(), done: calls.done() === 1 };
}

const tasks = {
  async open({ module, weights, trained, columns: count }) {
    columns = count;
    ({ exports: calls } = (await WebAssembly.instantiate(module, {})).instance);
    for (const bytes of weights) {
      give(bytes);
      check(calls.weights());
    }
    give(trained);
    check(calls.ego());
  },
  load(bytes) { give(bytes); check(calls.load()); },
  reset(config) {
    give(new TextEncoder().encode(config));
    check(calls.reset(0));
    return now();
  },
  step(action) {
    check(calls.step(...action));
    return now();
  },
  /** What the trained ego does in the scene: states of the ego [T, 8] and the last figures. */
  rival({ config, held }) {
    let seen = tasks.reset(config), action = [0, 0];
    const track = [...seen.states.slice(0, STATE)];
    for (let step = 0; !seen.done; step++) {
      if (step % held === 0) {
        check(calls.decide());
        action = [...floats(calls.action(), 2)];
      }
      seen = tasks.step(action);
      track.push(...seen.states.slice(0, STATE));
    }
    return { track, info: seen.info };
  },
};

onmessage = async ({ data: { id, task, given } }) => {
  try {
    postMessage({ id, value: await tasks[task](given) });
  } catch (error) {
    postMessage({ id, error: error.message });
  }
};
