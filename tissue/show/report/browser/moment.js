// The moment that charts and 3D view show, and the buttons that play it.

function makeMoment(start, end) {
  const listeners = [];
  const moment = {
    time: start,
    start,
    end,
    playing: false,
    listen: (call) => listeners.push(call),
    to(time) {
      moment.time = Math.min(Math.max(time, start), end);
      listeners.forEach((call) => call(moment.time));
    },
  };
  const slider = document.getElementById("time");
  const play = document.getElementById("play");
  const speed = document.getElementById("speed");
  const shown = document.getElementById("time-shown");
  const steps = 10000;
  slider.max = steps;
  slider.addEventListener("input", () => {
    pause();
    moment.to(start + ((end - start) * slider.value) / steps);
  });
  moment.listen((time) => {
    slider.value = end > start ? Math.round((steps * (time - start)) / (end - start)) : 0;
    slider.setAttribute("aria-valuetext", `${time.toFixed(3)} s`);
    shown.textContent = `${time.toFixed(3)} s`;
  });
  let last = 0;
  const step = (now) => {
    if (!moment.playing) return;
    const passed = Math.min(now - last, 100) * 1e-3;
    last = now;
    moment.to(moment.time + passed * Number(speed.value));
    if (moment.time >= end) pause();
    else requestAnimationFrame(step);
  };
  const pause = () => {
    moment.playing = false;
    play.textContent = "▶ play";
  };
  play.addEventListener("click", () => {
    if (moment.playing) return pause();
    if (moment.time >= end - 1e-9) moment.to(start);
    moment.playing = true;
    play.textContent = "❚❚ pause";
    last = performance.now();
    requestAnimationFrame(step);
  });
  document.querySelectorAll("[data-time]").forEach((each) =>
    each.addEventListener("click", () => {
      pause();
      moment.to(Number(each.dataset.time));
    }),
  );
  return moment;
}
