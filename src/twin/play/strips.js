// Strip charts of the last seconds: one canvas, one strip a group of signals with its unit.
const SHOWN = 20; // seconds
const LEFT = 46, RIGHT = 10, TOP = 22, GAP = 12, BOTTOM = 20;

export default {
  template: `<canvas ref="canvas" class="drawn" style="width:100%;height:100%;display:block"></canvas>`,
  props: { columns: Array, strips: Array },
  mounted() {
    this.rows = [];
    this.at = Object.fromEntries(this.columns.map((name, index) => [name, index]));
    this.watch = new ResizeObserver(() => this.draw());
    this.watch.observe(this.$refs.canvas);
  },
  unmounted() {
    this.watch.disconnect();
  },
  methods: {
    show(rows) {
      const t = this.at.time;
      for (const row of rows) {
        while (this.rows.length && this.rows[this.rows.length - 1][t] >= row[t]) this.rows.pop();
        this.rows.push(row);
      }
      if (!this.rows.length) return;
      const now = this.rows[this.rows.length - 1][t];
      while (this.rows[0][t] < now - SHOWN) this.rows.shift();
      this.draw();
    },
    draw() {
      const canvas = this.$refs.canvas, scale = window.devicePixelRatio || 1;
      const width = canvas.clientWidth, height = canvas.clientHeight;
      if (!width || !height) return;
      if (canvas.width !== Math.round(width * scale) || canvas.height !== Math.round(height * scale)) {
        canvas.width = Math.round(width * scale);
        canvas.height = Math.round(height * scale);
      }
      const pen = canvas.getContext("2d");
      pen.setTransform(scale, 0, 0, scale, 0, 0);
      pen.clearRect(0, 0, width, height);
      pen.font = "12px sans-serif";
      const now = this.rows.length ? this.rows[this.rows.length - 1][this.at.time] : 0;
      const begin = Math.max(0, now - SHOWN), each = (height - BOTTOM) / this.strips.length;
      this.strips.forEach((strip, i) => {
        this.strip(pen, strip, begin, i * each + TOP, width - LEFT - RIGHT, each - TOP - GAP);
      });
      pen.fillStyle = "#5b6770";
      pen.textAlign = "center";
      for (let s = Math.ceil(begin / 5) * 5; s <= begin + SHOWN; s += 5) {
        const x = LEFT + ((s - begin) / SHOWN) * (width - LEFT - RIGHT);
        pen.fillText(`${s} s`, Math.min(x, width - 14), height - 6);
      }
    },
    strip(pen, strip, begin, top, width, height) {
      const { curves, factor, title, least, signed } = strip;
      const index = curves.map(([column]) => this.at[column]);
      let most = least;
      for (const row of this.rows) {
        for (const i of index) {
          if (row[i] !== null && Number.isFinite(row[i])) most = Math.max(most, Math.abs(row[i] * factor));
        }
      }
      const step = [0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500].find((s) => most / s <= (signed ? 2 : 3)) || 1000;
      most = Math.ceil(most / step - 1e-9) * step;
      const y = (value) =>
        signed ? top + height / 2 - (value / most) * (height / 2) : top + height - (value / most) * height;
      pen.strokeStyle = "#dde3e8";
      pen.fillStyle = "#5b6770";
      pen.textAlign = "right";
      pen.lineWidth = 1;
      for (let value = signed ? -most : 0; value <= most + 1e-9; value += step) {
        pen.beginPath();
        pen.moveTo(LEFT, y(value));
        pen.lineTo(LEFT + width, y(value));
        pen.stroke();
        pen.fillText(`${value}`, LEFT - 6, y(value) + 4);
      }
      pen.textAlign = "left";
      pen.fillStyle = "#222";
      pen.font = "bold 12px sans-serif";
      pen.fillText(title, LEFT, top - 8);
      let x = LEFT + pen.measureText(title).width + 16;
      pen.font = "12px sans-serif";
      for (const [, name, colour] of curves.filter((curve) => curve[1])) {
        pen.fillStyle = colour;
        pen.fillRect(x, top - 13, 12, 3);
        pen.fillText(name, x + 16, top - 8);
        x += pen.measureText(name).width + 32;
      }
      index.forEach((i, k) => {
        pen.strokeStyle = curves[k][2];
        pen.lineWidth = 1.6;
        pen.beginPath();
        let drawing = false;
        for (const row of this.rows) {
          if (row[i] === null || !Number.isFinite(row[i])) {
            drawing = false;
            continue;
          }
          const px = LEFT + ((row[this.at.time] - begin) / SHOWN) * width, py = y(row[i] * factor);
          if (drawing) pen.lineTo(px, py);
          else pen.moveTo(px, py);
          drawing = true;
        }
        pen.stroke();
      });
    },
  },
};
