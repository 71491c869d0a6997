// A PID law with feedforward as an entry of the benchmark: docs/benchmark.md has the messages.
//
//     ballplate bench run . --out ../entry
"use strict";
const fs = require("fs");

const START = 0; // kind of message; else a command
const EQUIVALENT = 8, PATH = 20, PER_RIG = 30; // of each rig: x 0, equivalent 8, rate 16, requested 18, path 20
const SIGN = [1, -1]; // of a tilt that accelerates the ball along the axis

// The next `count` numbers, or null where there are no more.
function read(count) {
  const bytes = new Uint8Array(8 * count);
  for (let have = 0; have < bytes.length; ) {
    const got = fs.readSync(0, bytes, have, bytes.length - have);
    if (got === 0) return null;
    have += got;
  }
  return new Float64Array(bytes.buffer);
}

function write(numbers) {
  const bytes = new Uint8Array(Float64Array.of(numbers.length, ...numbers).buffer);
  for (let sent = 0; sent < bytes.length; ) sent += fs.writeSync(1, bytes, sent);
}

let period, q; // q: the integral of each rig's error along each axis

// Plate accelerations of rig k in rad/s^2.
function command(rig, k) {
  return [0, 1].map((axis) => {
    const [x, speed, tilt, rate] = rig.subarray(EQUIVALENT + 4 * axis);
    const path = (derivative) => rig[PATH + 2 * derivative + axis];
    const e = path(0) - x, v = path(1) - speed;
    const desired = path(2) + 4 * e + 4 * v + 1 * q[2 * k + axis];
    q[2 * k + axis] += period * e;
    return 400 * ((SIGN[axis] * desired) / 7 - tilt) - 40 * rate; // 5/7 of 9.81 m/s^2
  });
}

for (let count; (count = read(1)); ) {
  const [what, time, ...message] = read(count[0]);
  if (what === START) {
    period = time;
    q = new Float64Array(message.length / 4); // the message has the 8 states of each rig
    continue;
  }
  const rigs = Float64Array.from(message);
  const u = [];
  for (let k = 0; k < rigs.length / PER_RIG; k++)
    u.push(...command(rigs.subarray(PER_RIG * k, PER_RIG * (k + 1)), k));
  write(u);
}
