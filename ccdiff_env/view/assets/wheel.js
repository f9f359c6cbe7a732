// Steering wheel and pedals: what keys ask for, on the page and in its worker. ccdiff_env/view/link.py is the same.

const STEER_PER_STEP = 4 * 0.1; // full lock in a quarter of a second
const LOOK_M = 4; // who follows the way looks a second ahead, at least so far

/** Keys are numbers added up: accelerate 1, brake 2, left 4, right 8. States are x, y, heading, vx, vy. */
class Wheel {
  /** Way: [x, y, speed] of the log; top: the speed that nobody passes, m/s. */
  constructor({ way, top }) {
    Object.assign(this, { way, top, steer: 0 });
  }

  nearest(x, y) {
    const far = this.way.map(([px, py]) => (px - x) * (px - x) + (py - y) * (py - y));
    return far.indexOf(Math.min(...far));
  }

  turned(held) {
    const wanted = ((held & 4) > 0) - ((held & 8) > 0);
    return this.steer + Math.min(Math.max(wanted - this.steer, -STEER_PER_STEP), STEER_PER_STEP);
  }

  /** Acceleration and yaw rate, normalised; without a pedal the car rolls as its log does there. */
  action(held, [x, y, , vx, vy]) {
    this.steer = this.turned(held);
    const squared = vx * vx + vy * vy;
    const rolls = Math.min(Math.max(this.way[this.nearest(x, y)][2] - Math.sqrt(squared), -1), 1);
    const gas = held & 1 ? +(squared < this.top * this.top) : rolls;
    return [held & 2 ? -1 : gas, this.steer];
  }

  /** Keys that steer along the way, whoever is there. */
  along([x, y, heading, vx, vy]) {
    const speed = Math.hypot(vx, vy), far = ([px, py]) => Math.hypot(px - x, py - y);
    let at = this.nearest(x, y);
    while (at < this.way.length - 1 && far(this.way[at]) < Math.max(speed, LOOK_M)) at++;
    const dx = this.way[at][0] - x, dy = this.way[at][1] - y;
    const rate = 2 * speed * (Math.cos(heading) * dy - Math.sin(heading) * dx) / Math.max(dx * dx + dy * dy, 1);
    const off = (held) => Math.abs(this.turned(held) - rate);
    return [0, 4, 8].reduce((best, held) => (off(held) < off(best) ? held : best));
  }
}
