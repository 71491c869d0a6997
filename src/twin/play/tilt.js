// The plate from its sides, its longest one 700 long, its tilt drawn steeper than it is and told in numbers.
const STEEPER = 4;
const DEG = 180 / Math.PI;

export default {
  template: `
    <div>
      <div style="font-size:.8rem;color:var(--text)">Side view{{ sides.length > 1 ? "s" : "" }}; tilt is drawn {{ steeper }} times as steep</div>
      <div style="display:flex;flex-wrap:wrap;gap:.4rem">
      <div v-for="side in sides" :key="side.axis" style="flex:1 1 10rem">
        <svg class="drawn" viewBox="-400 -235 800 470" :data-testid="'side-' + side.axis"
             style="width:100%;display:block;background:#f4f6f8;border-radius:4px">
          <text v-if="sides.length > 1" x="-385" y="-190" font-size="40" fill="#37424a">{{ side.title }}</text>
          <text :ref="side.axis + 'Told'" x="-385" y="215" font-size="44" font-weight="bold" :fill="side.colour"/>
          <line x1="-385" y1="0" x2="385" y2="0" stroke="#9fb0bd" stroke-width="3" stroke-dasharray="14 10"/>
          <path d="M 0 4 L -34 110 H 34 Z" fill="#cfd8de" stroke="#5b6770" stroke-width="3"/>
          <g :ref="side.axis">
            <rect :x="-side.half" y="-6" :width="2 * side.half" height="12" rx="5" :fill="side.colour"/>
            <circle :ref="side.axis + 'Ball'" r="20" cy="-26" fill="#0072b2" stroke="#004b78" stroke-width="3"/>
            <g :ref="side.axis + 'Goal'" stroke="#d55e00" stroke-width="6" fill="none">
              <circle r="16" cy="-26"/><path d="M -26 -26 H 26 M 0 -52 V 0"/>
            </g>
          </g>
          <g fill="#5b6770" stroke="#5b6770" stroke-width="4" font-size="44">
            <text x="262" y="215" stroke="none">{{ side.axis }}</text>
            <path d="M 295 201 H 365 L 347 191 M 365 201 L 347 211" fill="none"/>
          </g>
        </svg>
      </div>
      </div>
    </div>`,
  props: { sides: Array, columns: Array },
  data() {
    return { steeper: STEEPER };
  },
  mounted() {
    this.at = Object.fromEntries(this.columns.map((name, index) => [name, index]));
  },
  methods: {
    // rows of numbers in SI, oldest first: the last one is what is drawn
    show(rows) {
      const row = rows[rows.length - 1];
      for (const { axis, angle, lowers, half, scale } of this.sides) {
        // what lowers the positive end turns clockwise
        const tilt = DEG * row[this.at[angle]], part = (name) => this.$refs[axis + name][0];
        const within = (name) => Math.max(-half, Math.min(half, scale * row[this.at[name]]));
        part("").setAttribute("transform", `rotate(${(lowers * STEEPER * tilt).toFixed(2)})`);
        part("Ball").setAttribute("cx", within(axis));
        part("Goal").setAttribute("transform", `translate(${within("goal_" + axis)} 0)`);
        part("Told").textContent = `${angle} ${(Math.round(10 * tilt) / 10 + 0).toFixed(1)}°`;
      }
    },
  },
};
