// The plate seen from above, y upwards: ball, clean model, goal, desired position, tilt. It is drawn
// as wide as the thesis's plate in mm: marks and words are as large on a tube of 100 mm.
// Drag anywhere to move the goal; drag from the ball to push it.
const SHOWN = 4; // seconds of the ball's way that are drawn
const PUSH = 2; // mm/s of push a mm of dragging
const STRONGEST = 400; // mm/s
const WIDTH = 700, HEIGHT = 395; // of the largest plate that is drawn
const BARS = [100, 50, 20, 10, 5]; // mm of the bar that shows the scale
const NS = "http://www.w3.org/2000/svg";

export default {
  template: `
    <svg ref="svg" class="drawn" :viewBox="box" style="width:100%;max-height:47vh;display:block;touch-action:none;user-select:none"
         @pointerdown="down" @pointermove="move" @pointerup="up" @pointercancel="up">
      <defs>
        <marker id="tip" viewBox="0 0 10 10" refX="8" refY="5" markerWidth="4" markerHeight="4"
                orient="auto-start-reverse"><path d="M0 0 L10 5 L0 10 z" fill="context-stroke"/></marker>
      </defs>
      <rect :x="-w/2" :y="-h/2" :width="w" :height="h" :rx="round ? w/2 : 6" fill="#f4f6f8" stroke="#5b6770" stroke-width="2"/>
      <rect :x="-reach[0]" :y="-reach[1]" :width="2*reach[0]" :height="2*reach[1]" fill="#ffffff"
            stroke="#9fb0bd" stroke-width="1" stroke-dasharray="6 5"/>
      <line v-if="line" :x1="-reach[0]" y1="0" :x2="reach[0]" y2="0" stroke="#9fb0bd" stroke-width="2" stroke-dasharray="6 5"/>
      <text :x="-reach[0]+6" :y="line ? -h/2+16 : -reach[1]+14" font-size="11" fill="#7b8a96">{{
        line ? "goals stay within the dashed line" : "goals stay within this area" }}</text>
      <path d="M -25 0 H 25 M 0 -25 V 25" stroke="#cfd8de" stroke-width="1"/>
      <g stroke="#5b6770" stroke-width="1.5" font-size="13" fill="#5b6770">
        <line :x1="-w/2+16" :y1="h/2-16" :x2="-w/2+66" :y2="h/2-16" marker-end="url(#tip)"/>
        <line v-if="!line" :x1="-w/2+16" :y1="h/2-16" :x2="-w/2+16" :y2="h/2-66" marker-end="url(#tip)"/>
        <text :x="-w/2+72" :y="h/2-12" stroke="none">x</text>
        <text v-if="!line" :x="-w/2+12" :y="h/2-72" stroke="none">y</text>
        <line :x1="w/2-16-scale*bar" :y1="h/2-14" :x2="w/2-16" :y2="h/2-14"/>
        <text :x="w/2-16-scale*bar/2" :y="h/2-19" stroke="none" text-anchor="middle">{{ bar }} mm</text>
      </g>
      <polyline ref="ghostTrail" fill="none" stroke="#009e73" stroke-width="1.5" stroke-dasharray="4 4" opacity="0.7"/>
      <polyline ref="trail" fill="none" stroke="#0072b2" stroke-width="2" opacity="0.6"/>
      <line ref="tilt" stroke="#37474f" stroke-width="3" marker-end="url(#tip)"/>
      <circle ref="ghost" :r="radius" fill="none" stroke="#009e73" stroke-width="2.5" stroke-dasharray="6 4"/>
      <circle ref="ball" :r="radius" fill="#0072b2" fill-opacity="0.85" stroke="#004b78" stroke-width="2" style="cursor:grab"/>
      <circle ref="desired" r="4" fill="#333"/>
      <g ref="goal" stroke="#d55e00" stroke-width="3" fill="none" style="cursor:move">
        <circle r="13" fill="#d55e00" fill-opacity="0.12"/><path d="M -20 0 H 20 M 0 -20 V 20"/>
      </g>
      <line ref="push" stroke="#c2185b" stroke-width="4" marker-end="url(#tip)" visibility="hidden"/>
      <text ref="pushed" font-size="13" fill="#c2185b" visibility="hidden"></text>
    </svg>`,
  props: { size: Array, area: Array, ball: Array, round: Boolean, columns: Array, drives: Boolean },
  data() {
    const scale = Math.min(WIDTH / this.size[0], HEIGHT / this.size[1]);
    const [w, h] = this.size.map((each) => scale * each);
    return {
      scale, w, h,
      box: `${-w / 2 - 4} ${-h / 2 - 4} ${w + 8} ${h + 8}`,
      reach: this.area.map((each) => scale * each),
      radius: scale * this.ball[0],
      line: this.area[1] === 0, // a rig of one axis
      bar: BARS.find((each) => scale * each <= 150) ?? BARS[BARS.length - 1],
    };
  },
  mounted() {
    this.way = [];
    this.now = null;
    this.held = null;
    this.at = Object.fromEntries(this.columns.map((name, index) => [name, index]));
  },
  methods: {
    // rows of numbers in SI, oldest first; a time before the last one: somebody went back
    show(rows) {
      const a = this.at;
      for (const row of rows) {
        const time = row[a.time];
        while (this.way.length && this.way[this.way.length - 1][a.time] >= time) this.way.pop();
        this.way.push(row);
      }
      const row = this.way[this.way.length - 1];
      if (!row) return;
      while (this.way[0][a.time] < row[a.time] - SHOWN) this.way.shift();
      this.now = row;
      this.draw(row);
    },
    draw(row) {
      const a = this.at, mm = (name) => 1000 * this.scale * row[a[name]];
      const put = (ref, x, y) => this.$refs[ref].setAttribute("transform", `translate(${x} ${-y})`);
      put("ball", mm("x"), mm("y"));
      put("desired", mm("desired_x"), mm("desired_y"));
      if (this.held !== "goal") put("goal", mm("goal_x"), mm("goal_y"));
      const there = row[a.ghost_x] !== null && Number.isFinite(row[a.ghost_x]);
      this.$refs.ghost.setAttribute("visibility", there ? "visible" : "hidden");
      if (there) put("ghost", mm("ghost_x"), mm("ghost_y"));
      const size = 1000 * this.scale;
      const points = (x, y) =>
        this.way
          .filter((each) => Number.isFinite(each[a[x]]) && each[a[x]] !== null)
          .map((each) => `${(size * each[a[x]]).toFixed(1)},${(-size * each[a[y]]).toFixed(1)}`)
          .join(" ");
      this.$refs.trail.setAttribute("points", points("x", "y"));
      this.$refs.ghostTrail.setAttribute("points", points("ghost_x", "ghost_y"));
      // downhill: x'' ~ +phi, y'' ~ -theta; 1 deg is as long as 30 mm of the widest plate
      const deg = 180 / Math.PI, x = 30 * deg * row[a.phi], y = -30 * deg * row[a.theta];
      const tilt = this.$refs.tilt;
      tilt.setAttribute("x2", x);
      tilt.setAttribute("y2", -y);
      tilt.setAttribute("visibility", Math.hypot(x, y) > 8 ? "visible" : "hidden");
      const svg = this.$refs.svg.dataset;
      svg.time = row[a.time];
      svg.x = row[a.x];
      svg.y = row[a.y];
      svg.goalX = row[a.goal_x];
      svg.goalY = row[a.goal_y];
      svg.factor = row[a.factor];
    },
    place(event) {
      const point = new DOMPoint(event.clientX, event.clientY);
      const at = point.matrixTransform(this.$refs.svg.getScreenCTM().inverse());
      return [at.x, -at.y];
    },
    down(event) {
      if (!this.drives || !this.now) return;
      this.$refs.svg.setPointerCapture(event.pointerId);
      const [x, y] = this.place(event), a = this.at, size = 1000 * this.scale;
      const far = (i, j) => Math.hypot(x - size * this.now[a[i]], y - size * this.now[a[j]]);
      const onBall = far("x", "y") < this.radius + 2, onGoal = far("goal_x", "goal_y") < 14;
      this.held = onBall && !(onGoal && far("goal_x", "goal_y") < far("x", "y")) ? "ball" : "goal";
      this.move(event);
    },
    move(event) {
      if (!this.held) return;
      const a = this.at, size = 1000 * this.scale, [x, aside] = this.place(event);
      const y = this.line ? size * this.now[a.y] : aside; // a push of a rig of one axis is along x
      if (this.held === "goal") {
        const gx = Math.max(-this.reach[0], Math.min(this.reach[0], x));
        const gy = Math.max(-this.reach[1], Math.min(this.reach[1], y));
        this.$refs.goal.setAttribute("transform", `translate(${gx} ${-gy})`);
        this.later = [gx / size, gy / size];
        if (!this.waiting) this.send();
        return;
      }
      const bx = size * this.now[a.x], by = size * this.now[a.y];
      const line = this.$refs.push, text = this.$refs.pushed;
      line.setAttribute("x1", bx);
      line.setAttribute("y1", -by);
      line.setAttribute("x2", x);
      line.setAttribute("y2", -y);
      line.setAttribute("visibility", "visible");
      this.kick = [x - bx, y - by].map((each) => (PUSH * each) / this.scale);
      const speed = Math.hypot(...this.kick);
      if (speed > STRONGEST) this.kick = this.kick.map((each) => (each * STRONGEST) / speed);
      text.textContent = `push ${Math.hypot(...this.kick).toFixed(0)} mm/s`;
      text.setAttribute("x", x + 10);
      text.setAttribute("y", -y);
      text.setAttribute("visibility", "visible");
    },
    // the first place at once, then the newest one every so often
    send() {
      const [x, y] = this.later;
      this.later = null;
      this.$emit("goal", { x, y });
      this.waiting = true;
      setTimeout(() => {
        this.waiting = false;
        if (this.later) this.send();
      }, 30);
    },
    up() {
      if (this.held === "ball" && this.kick && Math.hypot(...this.kick) > 5) {
        this.$emit("push", { x: this.kick[0] / 1000, y: this.kick[1] / 1000 });
      }
      this.$refs.push.setAttribute("visibility", "hidden");
      this.$refs.pushed.setAttribute("visibility", "hidden");
      this.held = this.kick = null;
    },
  },
};
