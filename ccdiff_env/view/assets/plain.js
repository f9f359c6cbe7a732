// Cards that menus choose: those with all that is chosen.
const menus = [...document.querySelectorAll(".above select")];
for (const menu of menus)
  menu.addEventListener("change", () => {
    for (const card of document.querySelectorAll("[data-of]")) {
      const of = JSON.parse(card.dataset.of);
      card.hidden = menus.some(({ value }, i) => value && value !== of[i]);
    }
  });

// Paper has no fold to open.
addEventListener("beforeprint", () => document.querySelectorAll("details").forEach((part) => { part.open = true; }));
