// What the page does by itself: a picture to click, drag a box on, zoom and move; and clicks on the 3D view.
(function () {
  const CLICK_PX = 4; // A press that moves less is a click.
  const HOVER_MS = 60;

  const Picture = {
    props: {
      src: String,
      width: Number,
      height: Number,
      centres: { type: Array, default: () => [] },
      radius: { type: Number, default: 0 }, // of the micro-images, as a share of the width
      spots: { type: Boolean, default: false }, // centres as mere spots, where they lie close together
      marked: { type: Array, default: null }, // left, top, width, height as shares
    },
    emits: ["pick", "box", "hover", "zoom", "move", "whole"],
    data: () => ({ from: null, to: null, moving: false, hovered: 0 }),
    computed: {
      // As large as the frame allows, in the picture's own proportions.
      size() {
        const ratio = this.width / this.height;
        return {
          width: `min(100cqw, ${100 * ratio}cqh)`,
          height: `min(100cqh, ${100 / ratio}cqw)`,
        };
      },
      // A quarter of a micro-image wide at most, so that the picture shows between the spots on any screen.
      spot() {
        return { strokeWidth: `min(2.5px, ${50 * this.radius}cqw)` };
      },
      points() {
        return this.centres.map((centre) => `M${centre[0] * this.width} ${centre[1] * this.height}h0`).join("");
      },
      drawn() {
        if (!this.from || !this.to || this.moving) return null;
        return this.css([
          Math.min(this.from.x, this.to.x), Math.min(this.from.y, this.to.y),
          Math.abs(this.to.x - this.from.x), Math.abs(this.to.y - this.from.y),
        ]);
      },
    },
    methods: {
      css(box) {
        return { left: `${100 * box[0]}%`, top: `${100 * box[1]}%`, width: `${100 * box[2]}%`, height: `${100 * box[3]}%` };
      },
      place(event) {
        const edge = this.$el.getBoundingClientRect();
        const share = (value) => Math.min(Math.max(value, 0), 1);
        return { x: share((event.clientX - edge.left) / edge.width), y: share((event.clientY - edge.top) / edge.height) };
      },
      isClick() {
        const edge = this.$el.getBoundingClientRect();
        return Math.hypot((this.to.x - this.from.x) * edge.width, (this.to.y - this.from.y) * edge.height) < CLICK_PX;
      },
      press(event) {
        if (event.button > 2) return;
        this.$el.setPointerCapture(event.pointerId);
        this.moving = event.button !== 0 || event.shiftKey;
        this.from = this.to = this.place(event);
      },
      drag(event) {
        const here = this.place(event);
        if (this.from) {
          if (this.moving) {
            this.$emit("move", [here.x - this.to.x, here.y - this.to.y]);
          }
          this.to = here;
        } else if (event.timeStamp - this.hovered > HOVER_MS) {
          this.hovered = event.timeStamp;
          this.$emit("hover", [here.x, here.y]);
        }
      },
      release(event) {
        if (!this.from) return;
        this.to = this.place(event);
        if (!this.moving) {
          if (this.isClick()) this.$emit("pick", [this.to.x, this.to.y]);
          else this.$emit("box", [this.from.x, this.from.y, this.to.x, this.to.y]);
        }
        this.from = this.to = null;
      },
      wheel(event) {
        const here = this.place(event);
        this.$emit("zoom", [here.x, here.y, Math.exp(-0.002 * event.deltaY)]);
      },
    },
    template: `
      <div class="picture crosshair" :style="size" @pointerdown.prevent="press" @pointermove="drag" @pointerup="release"
           @pointercancel="from = to = null" @wheel.prevent="wheel" @dblclick="$emit('whole')" @contextmenu.prevent>
        <img :src="src" alt="" draggable="false" />
        <svg v-if="centres.length" :viewBox="'0 0 ' + width + ' ' + height" preserveAspectRatio="none">
          <path v-if="spots" :d="points" stroke="#35d0ff" :style="spot" stroke-linecap="round" vector-effect="non-scaling-stroke" />
          <g v-else v-for="(centre, i) in centres" :key="i" fill="none" stroke="#35d0ff"
             :transform="'translate(' + centre[0] * width + ' ' + centre[1] * height + ')'">
            <circle :r="radius * width" stroke-width="1" stroke-opacity="0.45" vector-effect="non-scaling-stroke" />
            <path :d="'M' + -0.18 * radius * width + ' 0h' + 0.36 * radius * width + 'M0 ' + -0.18 * radius * width + 'v' + 0.36 * radius * width"
                  stroke-width="1.5" vector-effect="non-scaling-stroke" />
          </g>
        </svg>
        <div v-if="marked" class="marked" :style="css(marked)"></div>
        <div v-if="drawn" class="drawn" :style="drawn"></div>
      </div>`,
  };

  // Tells clicks on what it holds from drags, which turn the 3D view; places as shares, from the upper left.
  const Clicks = {
    emits: ["pick"],
    data: () => ({ from: null }),
    methods: {
      press(event) {
        this.from = event.button === 0 ? event : null;
      },
      release(event) {
        const from = this.from;
        this.from = null;
        if (!from || Math.hypot(event.clientX - from.clientX, event.clientY - from.clientY) >= CLICK_PX) return;
        const edge = this.$el.getBoundingClientRect();
        this.$emit("pick", [(event.clientX - edge.left) / edge.width, (event.clientY - edge.top) / edge.height]);
      },
    },
    template: `<div @pointerdown.capture="press" @pointerup.capture="release"><slot></slot></div>`,
  };

  // A picture, or several in turn.
  const Cycle = {
    props: { src: String, srcs: { type: Array, default: () => [] } },
    data: () => ({ at: 0, timer: 0 }),
    mounted() {
      this.timer = setInterval(() => { if (this.srcs.length) this.at = (this.at + 1) % this.srcs.length; }, 90);
    },
    unmounted() {
      clearInterval(this.timer);
    },
    template: `<img :src="srcs.length ? srcs[at % srcs.length] : src" alt="" />`,
  };

  window.lfmesh_page = {
    install(app) {
      app.component("LfPicture", Picture);
      app.component("LfClicks", Clicks);
      app.component("LfCycle", Cycle);
    },
  };
})();
