// What joins the pictures of a result: the slider, the buttons, and drawing anew on another width.

const opened = new Set();

function openResult(article) {
  if (opened.has(article)) return;
  opened.add(article);
  const { scene, charts } = JSON.parse(article.querySelector("script").textContent);
  const find = (name) => article.querySelector(`[data-part="${name}"]`);
  const slider = find("time"), clock = find("clock"), reading = find("reading");
  const shown = { space: find("space").dataset.all === "true", map: find("map").dataset.all === "true" };
  const look = { yaw: -0.6, pitch: 0.45, zoom: 1 };
  let movers = [], cursors = [], row = Number(slider.value);

  const show = (index) => {
    row = index;
    slider.value = index;
    article.dataset.frame = index;
    clock.textContent = scene.frames.clock[index];
    reading.textContent = scene.frames.text[index];
    slider.setAttribute("aria-valuetext", scene.frames.clock[index]);
    for (const move of movers) move(index);
    if (scene.frames.time.length > 1) for (const cursor of cursors) cursor(scene.frames.time[index]);
  };
  const views = () => {
    movers = [spaceView(find("space"), scene, shown.space, look), drawMap(find("map"), scene, shown.map)];
  };
  const drawAll = () => {
    views();
    cursors = [];
    for (const host of article.querySelectorAll("[data-chart]")) {
      cursors.push(drawChart(host, charts[Number(host.dataset.chart)]));
    }
    show(row);
  };
  slider.addEventListener("input", () => show(Number(slider.value)));
  for (const button of article.querySelectorAll("button[data-view]")) {
    button.addEventListener("click", () => {
      const { view } = button.dataset;
      shown[view] = button.dataset.all === "true";
      for (const other of article.querySelectorAll(`button[data-view="${view}"]`)) {
        other.setAttribute("aria-pressed", String(other === button));
      }
      views();
      show(row);
    });
  }
  for (const button of article.querySelectorAll("button[data-zoom]")) {
    button.addEventListener("click", () => {
      look.zoom = Math.min(50, Math.max(0.2, look.zoom * Number(button.dataset.zoom)));
      show(row);
    });
  }
  play(find("play"), slider, show);
  let width = 0;
  new ResizeObserver(() => {
    if (article.clientWidth === width || !article.clientWidth) return;
    width = article.clientWidth;
    requestAnimationFrame(drawAll);
  }).observe(article);
}

function play(button, slider, show) {
  const seconds = 12, last = Number(slider.max);
  let running = false, before = 0, place = 0;
  const stop = () => { running = false; button.textContent = "Play"; };
  const step = (now) => {
    if (!running) return;
    place += (now - before) / 1000 / seconds * last;
    before = now;
    show(Math.min(last, Math.round(place)));
    if (place >= last) stop(); else requestAnimationFrame(step);
  };
  button.addEventListener("click", () => {
    if (running) return stop();
    running = true;
    button.textContent = "Stop";
    place = Number(slider.value) >= last ? 0 : Number(slider.value);
    before = performance.now();
    requestAnimationFrame(step);
  });
  slider.addEventListener("pointerdown", stop);
}

function choose(articles, index) {
  articles.forEach((article, other) => { article.hidden = other !== index; });
  openResult(articles[index]);
}

const articles = [...document.querySelectorAll("article")];
const chooser = document.querySelector("#chooser");
if (chooser) {
  chooser.addEventListener("change", () => choose(articles, Number(chooser.value)));
  for (const button of document.querySelectorAll("button[data-result]")) {
    button.addEventListener("click", () => {
      chooser.value = button.dataset.result;
      choose(articles, Number(chooser.value));
      articles[Number(chooser.value)].scrollIntoView();
    });
  }
}
choose(articles, chooser ? Number(chooser.value) : 0);
