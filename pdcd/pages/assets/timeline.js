// When the refreshes of each shot came, and which of them were late.

const LOST = 1, DROPPED = 2, BLACK = 4;
const LATE_SHOWN = 40;
const BARS = 40;

function timeLine(data) {
  const shots = data.shots;
  const end = Math.max(...shots.map((s) => s.begin_s + s.length_s), 1e-9);
  let points = [];
  for (const shot of shots) $("shot").add(new Option(shot.name, shot.name));

  function lanes() {
    const canvas = $("lanes"), shown = shots.slice(0, BARS);
    canvas.style.height = `${48 + 16 * shown.length}px`;
    const [context, wide, high] = sharp(canvas);
    const at = axes(context, wide, high, { low: 0, high: end, name: "seconds from the first opening of the shutter" },
      { low: 0, high: shown.length, name: "", ticks: [] });
    shown.forEach((shot, number) => {
      const y = at.top + ((number + 0.5) * (at.bottom - at.top)) / shown.length;
      const from = at.across(shot.begin_s), to = at.across(shot.begin_s + shot.length_s);
      context.fillStyle = shot.name === $("shot").value ? colour("--accent") : colour("--quiet");
      context.globalAlpha = 0.55;
      context.fillRect(from, y - 5, Math.max(to - from, 1), 10);
      context.globalAlpha = 1;
      context.fillStyle = colour("--ink");
      const left = to + 120 < at.right;
      context.textAlign = left ? "left" : "right";
      context.fillText(`${shot.name}, ${shot.refreshes}`, left ? to + 4 : Math.max(from - 4, at.left + 90), y + 4);
    });
    late(context, at, shown);
  }

  async function late(context, at, shown) {
    for (const [number, shot] of shown.entries()) {
      if (!shot.late) continue;
      const [times, flags] = await Promise.all([unpack(shot.projector), unpack(shot.flags)]);
      const y = at.top + ((number + 0.5) * (at.bottom - at.top)) / shown.length;
      context.fillStyle = colour("--bad");
      flags.forEach((flag, i) => {
        if (flag & (LOST | DROPPED)) context.fillRect(at.across(shot.begin_s + times[i] * shot.unit_s) - 0.75, y - 7, 1.5, 14);
      });
    }
  }

  async function intervals() {
    const shot = shots.find((s) => s.name === $("shot").value);
    if (!shot) return;
    const [times, mask, flags, lost, number] = await Promise.all(
      [shot.projector, shot.mask, shot.flags, shot.lost, shot.number].map(unpack));
    const ms = 1000 * shot.unit_s;
    points = [];
    for (let i = 0; i < times.length; i++) {
      const next = shot.every && i > 0 ? (times[i] - times[i - 1]) * ms : NaN;
      points.push({
        number: number[i], at_s: times[i] * shot.unit_s, ms: next, skew: (mask[i] - times[i]) * ms,
        late: (flags[i] & (LOST | DROPPED)) > 0, lost: lost[i], dropped: (flags[i] & DROPPED) > 0, black: (flags[i] & BLACK) > 0,
      });
    }
    const [context, wide, high] = sharp($("intervals"));
    const known = points.map((p) => p.ms).filter(Number.isFinite);
    const top = Math.max(...known, 1), skews = points.map((p) => p.skew);
    const low = Math.min(0, ...skews);
    const at = axes(context, wide, high, { low: 0, high: shot.length_s, name: "seconds from the opening of the shutter" },
      { low, high: Math.max(1.1 * top, ...skews), name: "milliseconds" });
    for (const p of points) {
      p.x = at.across(p.at_s);
      p.y = at.down(Number.isFinite(p.ms) ? p.ms : 0);
      context.fillStyle = colour("--quiet");
      context.fillRect(p.x - 1, at.down(p.skew) - 1, 2, 2);
      context.fillStyle = p.late ? colour("--bad") : colour("--accent");
      if (p.late) context.fillRect(p.x - 2.5, p.y - 2.5, 5, 5);
      else context.fillRect(p.x - 1, p.y - 1, 2, 2);
    }
    const late = points.filter((p) => p.late);
    const words = late.slice(0, LATE_SHOWN).map((p) =>
      `${p.number} at ${written(p.at_s)} s${p.lost ? ` after ${p.lost} lost` : ""}${p.dropped ? ", another one shown" : ""}`);
    const more = late.length > LATE_SHOWN ? `; and ${late.length - LATE_SHOWN} more` : "";
    $("late-told").textContent = late.length ? `Late refreshes of ${shot.name}: ${words.join("; ")}${more}.` : `No refresh of ${shot.name} was late.`;
    document.body.dataset.late = `${shot.name} ${late.length}`;
  }

  function tell() {
    const total = shots.reduce((sum, s) => sum + s.refreshes, 0), missed = shots.reduce((sum, s) => sum + s.missed, 0);
    const unsure = shots.filter((s) => s.refreshes && !s.verified);
    let words = `${total} refreshes, ${missed} missed. Bars: the shutter is open; red: late or another one shown. ` +
      "Below, for one shot: blue, the time since the refresh before (projector); grey, how much later the mask changed.";
    if (shots.length > BARS) words += ` Bars of the first ${BARS} of ${shots.length} shots; the list has all.`;
    if (unsure.length) words += ` Times of ${unsure.length} shots are not verified (source ${unsure[0].source}).`;
    if (shots.some((s) => !s.every)) words += " Of long shots only what is late is kept here; frames.csv has all.";
    $("time-told").textContent = words;
  }

  $("shot").addEventListener("change", () => { lanes(); intervals().catch(fault); });
  $("intervals").addEventListener("pointermove", (event) => {
    const box = $("intervals").getBoundingClientRect(), x = event.clientX - box.left;
    let best = null;
    for (const p of points) if (!best || Math.abs(p.x - x) < Math.abs(best.x - x)) best = p;
    if (!best) return;
    $("time-readout").textContent = `refresh ${best.number} at ${written(best.at_s)} s, ${written(best.ms)} ms after the one before, mask ` +
      `${written(best.skew)} ms later${best.black ? ", mask black by plan" : ""}${best.late ? `, LATE (${best.lost} lost)` : ""}`;
  });

  async function start() {
    if (!shots.length) { $("time").hidden = true; return; }
    const worst = shots.reduce((a, b) => (b.late > a.late ? b : a));
    $("shot").value = (worst.late ? worst : shots.reduce((a, b) => (b.refreshes > a.refreshes ? b : a))).name;
    tell();
    lanes();
    await intervals();
  }
  return { start, redraw: () => { lanes(); intervals().catch(fault); } };
}
