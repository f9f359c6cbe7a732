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
// What the theme leaves out: levels of the captions beside, and diagrams for the keyboard.
for (const caption of document.querySelectorAll(".caption[role=heading]")) caption.ariaLevel = "2";
for (const pre of document.querySelectorAll(".highlight-text pre")) pre.tabIndex = 0;
// An interval, and a p-value, stand below their value.
for (const cell of document.querySelectorAll(".table-wrapper td > p")) {
  const [below] = cell.textContent.match(/\s\[[^\]]*\](, p .*)?$/) || [];
  if (!below || cell.children.length) continue;
  const small = document.createElement("small");
  small.textContent = below.trim().replace(", p", "\np");
  cell.textContent = cell.textContent.slice(0, -below.length);
  cell.append(small);
}
// A table that is wider than the page has a box for each row.
for (const wrapper of document.querySelectorAll(".table-wrapper")) {
  if (wrapper.scrollWidth <= wrapper.clientWidth) continue;
  const table = wrapper.querySelector("table");
  table.classList.add("boxes");
  const heads = [...table.tHead.rows[0].cells].map((cell) => cell.textContent);
  for (const row of table.tBodies[0].rows)
    for (const cell of row.cells) cell.dataset.head = heads[cell.cellIndex];
}
document.querySelector(".sidebar-drawer")?.setAttribute("aria-label", "pages");
document.querySelector(".toc-drawer")?.setAttribute("aria-label", "on this page");
