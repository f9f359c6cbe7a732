// The worker: worlds of the package as WebAssembly, and the trained ego that drives the same scene ahead.

const STATE = 8;
let calls, columns, road, wheel;

function give(bytes) {
  const at = calls.room(bytes.length);
  new Uint8Array(calls.memory.buffer, at, bytes.length).set(bytes);
}

function check(failed) {
  if (failed) throw new Error(new TextDecoder().decode(new Uint8Array(calls.memory.buffer, calls.message(), calls.message_length())));
}

const floats = (at, length) => new Float32Array(calls.memory.buffer, at, length);

/** States [A, 8] and the plan, see rust/wasm, figures of the step, and whether it was the last. */
function now() {
  return {
    states: floats(calls.states(), calls.num_agents() * STATE).slice(),
    info: floats(calls.columns(), columns).slice(),
    plan: floats(calls.plan(), calls.plan_length()).slice(),
    done: calls.done() === 1,
  };
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
  /** Bytes of a scene, and the way and the speed of its wheel. */
  load({ bytes, ...its }) {
    give(bytes);
    check(calls.load());
    road = its;
  },
  reset(config) {
    give(new TextEncoder().encode(config));
    check(calls.reset(0));
    wheel = new Wheel(road);
    return now();
  },
  /** One step with the keys that are held, or, of null, those that follow the way. */
  step(held) {
    const ego = floats(calls.states(), STATE);
    check(calls.step(...wheel.action(held ?? wheel.along(ego), ego)));
    return now();
  },
  /** A drive with the same keys in another world, which goes on along the way: states by step, and the last figures. */
  again({ config, keys }) {
    let seen = tasks.reset(config);
    const states = [seen.states];
    while (!seen.done) {
      seen = tasks.step(keys[states.length - 1] ?? null);
      states.push(seen.states);
    }
    return { states, info: seen.info };
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
      check(calls.step(...action));
      seen = now();
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
