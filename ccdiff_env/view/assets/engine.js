// The worker: worlds of the package as WebAssembly, and the two rivals that drive the same scene ahead.

const STATE = 8;
let calls, ego, columns;

function give(bytes) {
  const at = calls.room(bytes.length);
  new Uint8Array(calls.memory.buffer, at, bytes.length).set(bytes);
}

function check(failed) {
  if (failed) throw new Error(new TextDecoder().decode(new Uint8Array(calls.memory.buffer, calls.message(), calls.message_length())));
}

const floats = (at, length) => new Float32Array(calls.memory.buffer, at, length);

/** States [A, 8], see rust/wasm, figures of the step, and whether it was the last. */
function now(before) {
  const ms = performance.now() - before;
  return { states: floats(calls.states(), calls.num_agents() * STATE).slice(), info: floats(calls.columns(), columns).slice(), done: calls.done() === 1, ms };
}

/** rows @ weight.T + bias of one row, then the greater of it and 0. */
function layer(name, x, last = false) {
  const weight = ego.tensors[`${name}.weight`], bias = ego.tensors[`${name}.bias`], n = x.length;
  return bias.map((b, i) => {
    let sum = b;
    for (let j = 0; j < n; j++) sum += weight[i * n + j] * x[j];
    return last ? Math.min(Math.max(sum, -1), 1) : Math.max(sum, 0);
  });
}

/** The trained ego, as ccdiff_env/policies/ego.py has it but in another order of sums. */
function act(obs) {
  const { mean, std } = ego.tensors, { rows: [at, count, width], mask } = ego;
  const x = Array.from(obs, (value, i) => Math.min(Math.max((value - mean[i]) / std[i], -5), 5));
  const seen = new Array(ego.tensors["encoder.2.bias"].length).fill(0);
  for (let r = 0; r < count; r++) {
    if (!obs[mask + r]) continue;
    const row = layer("encoder.2", layer("encoder.0", x.slice(at + r * width, at + (r + 1) * width)));
    row.forEach((value, i) => { seen[i] = Math.max(seen[i], value); });
  }
  const h = [...x.slice(0, at), ...x.slice(mask + count), ...seen];
  return layer("policy.4", layer("policy.2", layer("policy.0", h)), true);
}

const tasks = {
  async open({ module, weights, policy, columns: count }) {
    columns = count;
    ({ exports: calls } = (await WebAssembly.instantiate(module, {})).instance);
    for (const bytes of weights) {
      give(bytes);
      check(calls.weights());
    }
    ego = policy;
    for (const [name, [from, length]] of Object.entries(ego.places)) ego.tensors[name] = Array.from(new Float32Array(ego.numbers, 4 * from, length));
  },
  load(bytes) { give(bytes); check(calls.load()); },
  reset(config) {
    const before = performance.now();
    give(new TextEncoder().encode(config));
    check(calls.reset(0));
    return now(before);
  },
  step(action) {
    const before = performance.now();
    check(calls.step(...action));
    return now(before);
  },
  /** What a rival does in the scene: states of the ego [T, 8] and the last figures. */
  rival({ config, trained }) {
    let seen = tasks.reset(config), action = [0, 0];
    const track = [...seen.states.slice(0, STATE)];
    for (let step = 0; !seen.done; step++) {
      if (trained && step % ego.held === 0) action = act(floats(calls.observation(), ego.size));
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
