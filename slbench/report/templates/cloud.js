// The 3-D views of a report.  Each figure.cloud has its points as JSON beside it; the plotting
// library lies compressed in the page and is unpacked when the first view comes into sight.
// All text goes into the page as text; the library is given numbers and fixed words alone.
(() => {
  'use strict';

  // A browser keeps few WebGL contexts: views out of sight give theirs back beyond this many.
  const MOST_ALIVE = 4;
  // Grey for points without a value; colours of values take the upper half of the scale.
  const GREY = '#8d8d8d';

  let library = null;
  const alive = [];

  function loadLibrary() {
    library = library || (async () => {
      const packed = Uint8Array.from(
        atob(document.getElementById('library').textContent), (c) => c.charCodeAt(0));
      const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream('gzip'));
      const script = document.createElement('script');
      script.textContent = await new Response(stream).text();
      document.head.append(script);
      return window.Plotly;
    })();
    return library;
  }

  function hasWebGL() {
    const canvas = document.createElement('canvas');
    const context = canvas.getContext('webgl');
    if (!context) return false;
    const lose = context.getExtension('WEBGL_lose_context');
    if (lose) lose.loseContext();
    return true;
  }

  function unpack(text) {
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    return new Float32Array(bytes.buffer);
  }

  function bytes(text) {
    return text && Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  }

  // Colours of a shape: those of the scale, each point darker or brighter by its shade.
  function shaded({ values, low, high, colours, shade }, bright) {
    const stops = colours.map((c) => [1, 3, 5].map((k) => parseInt(c.slice(k, k + 2), 16)));
    const last = stops.length - 1;
    return Array.from(values, (v, n) => {
      const place = last * Math.min(1, Math.max(0, (v - low) / (high - low)));
      const k = Math.min(last - 1, Math.floor(place));
      const mixed = [0, 1, 2].map((c) => Math.min(255, Math.round((shade[n] / bright)
        * (stops[k][c] + (place - k) * (stops[k + 1][c] - stops[k][c])))));
      return `rgb(${mixed.join()})`;
    });
  }

  // Values as places on the scale: 0 at the low end, 1 at the high end, -1 without a value.
  function places(colouring) {
    const { values, low, high } = colouring;
    return values.map((v) => (
      Number.isNaN(v) ? -1 : Math.min(1, Math.max(0, (v - low) / (high - low)))));
  }

  function scale(colours) {
    const last = colours.length - 1;
    return [[0, GREY], [0.49, GREY], ...colours.map((c, k) => [0.5 + (0.5 * k) / last, c])];
  }

  function number(value, digits) {
    return Number(value.toPrecision(digits)).toString().replace('-', '\u2212');
  }

  function gap(touches) {
    return Math.hypot(
      touches[0].clientX - touches[1].clientX, touches[0].clientY - touches[1].clientY);
  }

  // The oldest out of sight first.
  function thinOut() {
    for (const view of alive.filter((v) => !v.inSight)) {
      if (alive.length > MOST_ALIVE) view.rest();
    }
  }

  class View {
    constructor(figure) {
      const data = JSON.parse(document.getElementById(figure.dataset.from).textContent);
      this.figure = figure;
      this.data = data;
      this.stage = figure.querySelector('.stage');
      this.readout = figure.querySelector('.readout');
      this.hint = this.readout.textContent;
      this.points = data.points.map(unpack);
      this.truth = data.truth && data.truth.map(unpack);
      this.colourings = data.colourings.map(
        (c) => ({ ...c, values: unpack(c.values), shade: bytes(c.shade) }));
      this.shown = [true, false];
      this.current = 0;
      this.asked = false;
      this.ready = false;
      this.listen();
    }

    // -- what is drawn ---------------------------------------------------------------------

    marker() {
      const colouring = this.colourings[this.current];
      return {
        size: this.data.size,
        line: { width: 0 },
        color: colouring.shade ? shaded(colouring, this.data.bright) : places(colouring),
        colorscale: scale(colouring.colours),
        cmin: -1,
        cmax: 1,
        showscale: false,
      };
    }

    traces() {
      const trace = (points, marker, visible, hoverinfo) => ({
        type: 'scatter3d',
        mode: 'markers',
        x: points[0],
        y: points[1],
        z: points[2],
        marker,
        visible,
        hoverinfo,
      });
      const all = [trace(this.points, this.marker(), this.shown[0], 'none')];
      if (this.truth) {
        const marker = { size: 1.5, line: { width: 0 }, color: this.theme().truth };
        all.push(trace(this.truth, marker, this.shown[1], 'skip'));
      }
      return all;
    }

    layout() {
      const { ink, rule } = this.theme();
      const largest = Math.max(...this.data.aspect);
      const axis = (k) => ({
        title: { text: `${'xyz'[k]} / ${this.data.unit}` },
        range: this.data.box[k],
        nticks: Math.max(2, Math.round((8 * this.data.aspect[k]) / largest)),
        color: ink,
        gridcolor: rule,
        zerolinecolor: rule,
        showbackground: false,
        showspikes: false,
      });
      const [x, y, z] = this.data.aspect;
      return {
        margin: { l: 0, r: 0, t: 0, b: 0 },
        showlegend: false,
        paper_bgcolor: 'rgba(0,0,0,0)',
        scene: {
          xaxis: axis(0),
          yaxis: axis(1),
          zaxis: axis(2),
          aspectmode: 'manual',
          aspectratio: { x, y, z },
          dragmode: 'turntable',
          camera: structuredClone(this.camera),
        },
      };
    }

    // From further away where the stage is high and narrow; the axes' labels need room below.
    firstCamera() {
      const far = Math.max(1, (1.3 * this.stage.clientHeight) / this.stage.clientWidth);
      const [x, y, z] = this.data.eye.map((a) => far * a);
      return { eye: { x, y, z }, center: { x: 0, y: 0, z: -0.22 }, up: { x: 0, y: 0, z: 1 } };
    }

    theme() {
      const style = getComputedStyle(document.documentElement);
      const [ink, rule, truth] = ['--ink', '--rule', '--truth'].map(
        (name) => style.getPropertyValue(name).trim());
      return { ink, rule, truth };
    }

    async draw() {
      if (this.asked) return;
      this.asked = true;
      try {
        this.plotly = await loadLibrary();
        this.figure.dataset.state = 'drawn';
        this.start = this.start || this.firstCamera();
        this.camera = this.camera || structuredClone(this.start);
        await this.plotly.newPlot(this.stage, this.traces(), this.layout(), {
          displayModeBar: false,
          doubleClick: false,
          responsive: true,
          scrollZoom: true,
        });
      } catch (error) {
        this.giveUp('The 3-D view could not be drawn here');
        return;
      }
      this.stage.on('plotly_hover', (event) => this.read(event.points[0]));
      this.stage.on('plotly_unhover', () => this.say(this.hint));
      this.stage.on('plotly_webglcontextlost', () => {
        this.rest();
        this.say('The browser has dropped the view: \u201cReset view\u201d draws it again.');
      });
      this.showBar();
      this.ready = true;
      this.figure.dataset.ready = 'yes';
      alive.push(this);
      thinOut();
    }

    rest() {
      if (!this.ready) return;
      this.keepCamera();
      this.plotly.purge(this.stage);
      this.asked = false;
      this.ready = false;
      delete this.figure.dataset.ready;
      const place = alive.indexOf(this);
      if (place >= 0) alive.splice(place, 1);
    }

    giveUp(why) {
      this.figure.dataset.state = 'none';
      this.figure.querySelector('.words').textContent =
        `${why}; this picture shows the cloud from one side.`;
    }

    // -- what is said ----------------------------------------------------------------------

    say(text) {
      this.readout.textContent = text;
    }

    read(point) {
      const k = point.pointNumber;
      const place = this.points.map((axis, a) => `${'xyz'[a]} ${number(axis[k], 6)}`);
      const { what, unit, values } = this.colourings[this.current];
      const value = Number.isNaN(values[k]) ? 'none' : `${number(values[k], 4)} ${unit}`;
      this.say(`${place.join(', ')} ${this.data.unit}; ${what} ${value}`);
    }

    showBar() {
      const { what, unit, low, high, colours } = this.colourings[this.current];
      const bar = this.figure.querySelector('.bar');
      const ends = [low, high].map((end) => number(end, 3));
      bar.querySelector('.what').textContent = unit ? `${what} / ${unit}` : what;
      bar.querySelector('.low').textContent = ends[0];
      bar.querySelector('.high').textContent = ends[1];
      bar.querySelector('.ramp').style.background = `linear-gradient(to right, ${colours.join()})`;
      bar.setAttribute('aria-label', `Colours: ${what} from ${ends[0]} to ${ends[1]} ${unit}`);
    }

    // -- what one can do -------------------------------------------------------------------

    listen() {
      for (const input of this.figure.querySelectorAll('input[type=radio]')) {
        input.addEventListener('change', () => this.colour(Number(input.value)));
      }
      for (const input of this.figure.querySelectorAll('input[type=checkbox]')) {
        input.addEventListener('change', () => this.show(Number(input.value), input.checked));
      }
      for (const button of this.figure.querySelectorAll('button')) {
        button.addEventListener('click', () => this.press(button.value));
      }
      this.stage.addEventListener('keydown', (event) => this.key(event));
      this.listenToPinches();
    }

    colour(k) {
      this.current = k;
      this.showBar();
      if (!this.ready) return;
      const { color, colorscale } = this.marker();
      this.plotly.restyle(
        this.stage, { 'marker.color': [color], 'marker.colorscale': [colorscale] }, [0]);
    }

    show(layer, visible) {
      this.shown[layer] = visible;
      if (this.ready) this.plotly.restyle(this.stage, { visible }, [layer]);
    }

    press(what) {
      if (what === 'reset') this.look(structuredClone(this.start));
      else this.zoom(what === 'in' ? 0.8 : 1.25);
    }

    key(event) {
      const step = Math.PI / 18;
      const actions = {
        ArrowLeft: () => this.turn(-step, 0),
        ArrowRight: () => this.turn(step, 0),
        ArrowUp: () => this.turn(0, step),
        ArrowDown: () => this.turn(0, -step),
        '+': () => this.zoom(0.8),
        '=': () => this.zoom(0.8),
        '-': () => this.zoom(1.25),
        0: () => this.press('reset'),
      };
      if (!(event.key in actions) || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      actions[event.key]();
    }

    // Asked of the scene: the library's layout learns of a wheel late, of a finger never.
    keepCamera() {
      if (!this.ready) return;
      const { eye, center, up } = this.stage._fullLayout.scene._scene.getCamera();
      this.camera = { eye, center, up };
    }

    look(camera) {
      this.camera = camera;
      if (this.ready) this.plotly.relayout(this.stage, { 'scene.camera': structuredClone(camera) });
      else this.draw();
    }

    zoom(factor) {
      this.keepCamera();
      this.approach(this.camera, factor);
    }

    approach({ eye, center, up }, factor) {
      const along = (a) => center[a] + factor * (eye[a] - center[a]);
      const far = Math.hypot(...['x', 'y', 'z'].map((a) => factor * (eye[a] - center[a])));
      if (far < 0.05 || far > 20) return;
      this.look({ eye: { x: along('x'), y: along('y'), z: along('z') }, center, up });
    }

    turn(azimuth, elevation) {
      this.keepCamera();
      const { eye, center, up } = this.camera;
      const [x, y, z] = ['x', 'y', 'z'].map((a) => eye[a] - center[a]);
      const radius = Math.hypot(x, y, z);
      const a = Math.atan2(y, x) + azimuth;
      // Short of the poles, where the turntable would lose its direction.
      const e = Math.min(1.55, Math.max(-1.55, Math.asin(z / radius) + elevation));
      this.look({
        eye: {
          x: center.x + radius * Math.cos(e) * Math.cos(a),
          y: center.y + radius * Math.cos(e) * Math.sin(a),
          z: center.z + radius * Math.sin(e),
        },
        center,
        up,
      });
    }

    // The library turns with one finger; two fingers zoom here, and it does not see them until
    // all are lifted.
    listenToPinches() {
      let pinch = null;
      const take = (event) => {
        event.preventDefault();
        event.stopPropagation();
      };
      const options = { capture: true, passive: false };
      this.stage.addEventListener('touchstart', (event) => {
        if (event.touches.length < 2) return;
        this.keepCamera();
        pinch = { gap: gap(event.touches), camera: structuredClone(this.camera) };
        take(event);
      }, options);
      this.stage.addEventListener('touchmove', (event) => {
        if (!pinch) return;
        if (event.touches.length === 2) {
          this.approach(pinch.camera, pinch.gap / Math.max(gap(event.touches), 1));
        }
        take(event);
      }, options);
      for (const end of ['touchend', 'touchcancel']) {
        this.stage.addEventListener(end, (event) => {
          if (!event.touches.length) pinch = null;
        }, options);
      }
    }
  }

  const views = new Map();
  const usable = hasWebGL() && 'DecompressionStream' in window;
  for (const figure of document.querySelectorAll('figure.cloud[data-from]')) {
    if (!figure.querySelector('.stage')) continue;
    const view = new View(figure);
    views.set(figure, view);
    if (!usable) view.giveUp('This browser has no WebGL, which the 3-D view needs');
  }
  if (!usable) return;

  const watcher = new IntersectionObserver((entries) => {
    for (const entry of entries) {
      const view = views.get(entry.target);
      view.inSight = entry.isIntersecting;
      if (view.inSight) view.draw();
    }
    thinOut();
  }, { rootMargin: '300px' });
  for (const figure of views.keys()) watcher.observe(figure);

  matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => {
    for (const view of alive) {
      view.keepCamera();
      view.plotly.react(view.stage, view.traces(), view.layout());
    }
  });
})();
