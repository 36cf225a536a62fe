"use strict";
// Opens pages in frames of several widths and reports, as JSON in the document, what a reader would stumble over.
const CLIPS = /auto|scroll|hidden|clip/, LEAST = 7.5;  // px
function clipped(rect, element) {
  let [x0, y0, x1, y1] = [rect.left, rect.top, rect.right, rect.bottom];
  for (let e = element; e && e !== e.ownerDocument.documentElement; e = e.parentElement) {
    const style = e.ownerDocument.defaultView.getComputedStyle(e);
    if (!CLIPS.test(style.overflowX + style.overflowY)) continue;
    const box = e.getBoundingClientRect();
    [x0, y0, x1, y1] = [Math.max(x0, box.left), Math.max(y0, box.top), Math.min(x1, box.right), Math.min(y1, box.bottom)];
  }
  return { x0, y0, x1, y1 };
}
function shownTexts(page) {
  const walker = page.createTreeWalker(page.body, NodeFilter.SHOW_TEXT), found = [];
  for (let node = walker.nextNode(); node; node = walker.nextNode()) {
    const holder = node.parentElement;
    if (!node.data.trim() || holder.closest("script,style") || !holder.checkVisibility()) continue;
    const range = page.createRange();
    range.selectNodeContents(node);
    for (const rect of range.getClientRects()) {
      const box = clipped(rect, holder);
      if (box.x1 - box.x0 > 1 && box.y1 - box.y0 > 1) found.push({ ...box, size: letterSize(holder), text: node.data.trim().slice(0, 40) });
    }
  }
  return found.sort((a, b) => a.y0 - b.y0);
}
function overlaps(page) {
  const texts = shownTexts(page), found = [];
  for (let i = 0; i < texts.length; i++) {
    for (let j = i + 1; j < texts.length && texts[j].y0 < texts[i].y1; j++) {
      const [a, b] = [texts[i], texts[j]], wide = Math.min(a.x1, b.x1) - Math.max(a.x0, b.x0);
      const high = Math.min(a.y1, b.y1) - b.y0, least = Math.min(a.y1 - a.y0, b.y1 - b.y0);
      if (wide > 2 && high > 0.4 * least) found.push(`${a.text} / ${b.text}`);
    }
  }
  return found;
}
function letterSize(holder) {
  const size = parseFloat(holder.ownerDocument.defaultView.getComputedStyle(holder).fontSize);
  const drawn = holder.getScreenCTM?.();  // letters of a figure, which the page scales and which may be turned
  return drawn ? size * Math.sqrt(Math.abs(drawn.a * drawn.d - drawn.b * drawn.c)) : size;
}
function small(page) {
  return shownTexts(page).filter((one) => one.size < LEAST).map((one) => `${one.text} (${one.size.toFixed(1)} px)`);
}
async function opened(width, source) {
  const frame = document.createElement("iframe");
  frame.style = `width:${width}px;height:1000px;border:0`;
  const loaded = new Promise((done) => frame.addEventListener("load", done));
  Object.assign(frame, source);
  document.body.append(frame);
  await loaded;
  return frame;
}
async function judged(path, width, axe) {
  // the page's policy forbids scripts of others, axe too: a copy without the policy is judged
  const text = await (await fetch(`file://${path}`)).text();
  const frame = await opened(width, { srcdoc: text.replace(/<meta http-equiv="Content-Security-Policy"[^>]*>/, "") });
  const view = frame.contentWindow, script = frame.contentDocument.createElement("script");
  script.textContent = axe;
  frame.contentDocument.head.append(script);
  for (const one of frame.contentDocument.querySelectorAll("details")) one.open = true;
  const found = await view.axe.run(frame.contentDocument, { resultTypes: ["violations"] });
  frame.remove();
  const serious = found.violations.filter((one) => /serious|critical/.test(one.impact));
  return { rules: found.passes.length, serious: serious.map((one) => `${one.id}: ${one.nodes[0].html}`) };
}
async function checked(path, width, axe) {
  const frame = await opened(width, { src: `file://${path}` }), view = frame.contentWindow, page = frame.contentDocument;
  const fetched = view.performance.getEntriesByType("resource").map((one) => one.name);
  const canvas = page.querySelector("[data-scene] canvas");
  let turns = null;  // whether the view turns, and hides a kind
  if (canvas) {
    const before = canvas.toDataURL();
    canvas.dispatchEvent(new view.KeyboardEvent("keydown", { key: "ArrowRight" }));
    turns = canvas.toDataURL() !== before;
    const whole = canvas.toDataURL();
    page.querySelector("[data-scene] .legend button").click();
    turns &&= canvas.toDataURL() !== whole;
  }
  for (const one of page.querySelectorAll("details")) one.open = true;
  const beyond = page.documentElement.scrollWidth - page.documentElement.clientWidth, over = overlaps(page);
  const tiny = small(page);
  frame.remove();
  return { path, width, fetched, turns, beyond, overlaps: over, small: tiny, ...(await judged(path, width, axe)) };
}
async function beyondPaper(path) {
  // the paper of A4 without its margins of 16 mm, with the rules of print in place of those of the screen
  const frame = await opened(Math.round((178 / 25.4) * 96), { src: `file://${path}` }), page = frame.contentDocument;
  for (const sheet of page.styleSheets) {
    for (const rule of sheet.cssRules) {
      if (rule.media && /print|screen/.test(rule.media.mediaText)) rule.media.mediaText = /print/.test(rule.media.mediaText) ? "all" : "not all";
    }
  }
  for (const one of page.querySelectorAll("details")) one.open = true;
  const beyond = page.documentElement.scrollWidth - page.documentElement.clientWidth;
  frame.remove();
  return beyond;
}
async function withoutScripts(path) {
  const frame = await opened(1280, { sandbox: "allow-same-origin", src: `file://${path}` }), page = frame.contentDocument;
  const texts = shownTexts(page).map((one) => one.text), canvases = page.querySelectorAll("canvas").length;
  frame.remove();
  return { path, texts, canvases };
}
async function reported(paths, widths, axe) {
  const pages = [], plain = [];
  for (const path of paths) {
    for (const width of widths) pages.push(await checked(path, width, axe));
    plain.push({ ...(await withoutScripts(path)), paper: await beyondPaper(path) });
  }
  console.log(`REPORT${JSON.stringify({ pages, plain })}END`);
}
