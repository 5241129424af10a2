// Begins when the page is there. `window.report` is for scripts that look at a page.

function fault(error) {
  $("fault").hidden = false;
  $("fault").textContent = `The page has a fault: ${error}`;
  console.error(error);
}

async function begin() {
  if (typeof DecompressionStream === "undefined") throw new Error("this browser is too old to unpack pictures");
  const data = JSON.parse($("data").textContent);
  const matrix = matrixViewer(data);
  const pictures = pictureViewer(data, (cell) => matrix.choose(cell).catch(fault));
  const time = timeLine(data);
  await Promise.all([pictures.start(), matrix.start(), time.start()]);
  window.report = { valuesAt: pictures.valuesAt, row: matrix.row };
  let waiting = 0;
  const redraw = () => {
    clearTimeout(waiting);
    waiting = setTimeout(() => { pictures.redraw(); time.redraw(); }, 100);
  };
  window.addEventListener("resize", redraw);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  document.body.dataset.ready = "yes";
}

begin().catch(fault);
