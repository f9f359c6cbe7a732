// A button that copies, on each block of code.
for (const block of document.querySelectorAll("div.highlight")) {
  const button = document.createElement("button");
  button.className = "copy";
  button.textContent = "Copy";
  button.addEventListener("click", async () => {
    await navigator.clipboard.writeText(block.querySelector("pre").textContent);
    button.textContent = "Copied";
    setTimeout(() => { button.textContent = "Copy"; }, 1500);
  });
  block.style.position = "relative";
  block.append(button);
}
// What the theme leaves out: levels of the captions beside, and wide blocks for the keyboard.
for (const caption of document.querySelectorAll(".caption[role=heading]")) caption.ariaLevel = "2";
for (const wide of document.querySelectorAll("pre, .table-wrapper")) wide.tabIndex = 0;
// An interval stands below its value.
for (const cell of document.querySelectorAll(".table-wrapper td > p")) {
  const [whole, interval] = cell.textContent.match(/\s(\[[^\]]*\])$/) || [];
  if (!whole || cell.children.length) continue;
  const small = document.createElement("small");
  small.textContent = interval;
  cell.textContent = cell.textContent.slice(0, -whole.length);
  cell.append(small);
}
document.querySelector(".sidebar-drawer")?.setAttribute("aria-label", "pages");
document.querySelector(".toc-drawer")?.setAttribute("aria-label", "on this page");
