// Moves the drawings. Without it the page shows the poses along the run.
document.querySelectorAll("figure.motion").forEach((figure) => {
  const { t, sizes, poses } = JSON.parse(figure.querySelector("script").textContent);
  const lines = [...figure.querySelectorAll(".pose polyline")];
  const [controls, button, slider, time] = ["div", "button", "input", "output"].map((n) => document.createElement(n));
  const whole = t[t.length - 1] - t[0];
  const lasts = Math.min(Math.max(whole, 2), 20); // seconds of watching
  const speed = Math.abs(lasts / whole - 1) < 0.01 ? "" : ", " + (whole / lasts).toPrecision(2) + " times as fast";
  let now = whole, before = null;

  function show(at) {
    now = Math.min(Math.max(at, 0), whole);
    let k = 1;
    while (k < t.length - 1 && t[k] - t[0] < now) k++;
    const gap = t[k] - t[k - 1];
    const share = gap > 0 ? Math.min(Math.max((now - t[k - 1] + t[0]) / gap, 0), 1) : 1;
    let from = 0;
    lines.forEach((line, n) => {
      const points = [];
      for (let i = from; i < from + 2 * sizes[n]; i++)
        points.push((poses[k - 1][i] * (1 - share) + poses[k][i] * share).toFixed(1));
      from += 2 * sizes[n];
      line.setAttribute("points", points.join(" "));
    });
    slider.value = now;
    time.textContent = "t = " + (t[0] + now).toFixed(2) + " s";
  }
  function name() {
    button.textContent = before === null ? "Play" : "Pause";
    figure.classList.toggle("playing", before !== null);
  }
  function tick(stamp) {
    if (before === null) return;
    show(now + ((stamp - before) / 1000) * (whole / lasts));
    before = now < whole ? stamp : null;
    if (before === null) name();
    else requestAnimationFrame(tick);
  }
  function play() {
    if (now >= whole) show(0);
    before = performance.now();
    name();
    requestAnimationFrame(tick);
  }
  function pause() {
    before = null;
    name();
  }
  button.type = "button";
  button.onclick = () => (before === null ? play() : pause());
  Object.assign(slider, { type: "range", min: 0, max: whole, step: whole / 1000 });
  slider.setAttribute("aria-label", "time in seconds");
  slider.oninput = () => {
    pause();
    show(Number(slider.value));
  };
  controls.className = "controls";
  controls.append(button, slider, time);
  if (speed) controls.title = "shown" + speed.slice(1);
  figure.append(controls);
  show(whole);
  name();
  // once by itself, where it is seen and nobody minds motion
  if (matchMedia("(prefers-reduced-motion: reduce)").matches || !("IntersectionObserver" in window)) return;
  const watch = new IntersectionObserver((seen) => {
    if (!seen.some((s) => s.isIntersecting)) return;
    watch.disconnect();
    play();
  }, { threshold: 0.6 });
  watch.observe(figure);
});
