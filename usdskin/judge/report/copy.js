// Copies commands, with the clipboard where the browser gives it and by selection where not.

async function copyText(text) {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    const area = document.createElement("textarea");
    area.value = text;
    document.body.append(area);
    area.select();
    const done = document.execCommand("copy");
    area.remove();
    return done;
  }
}

for (const button of document.querySelectorAll("button.copy")) {
  const said = button.textContent;
  button.addEventListener("click", async () => {
    const named = button.dataset.copies;
    const source = named ? document.getElementById(named) : button.previousElementSibling;
    button.textContent = (await copyText(source.textContent)) ? "Copied" : "Not allowed";
    setTimeout(() => { button.textContent = said; }, 1500);
  });
}

// Folded parts are printed too.
const folded = () => document.querySelectorAll("details:not([open])");
addEventListener("beforeprint", () => {
  for (const part of folded()) {
    part.dataset.folded = "";
    part.open = true;
  }
});
addEventListener("afterprint", () => {
  for (const part of document.querySelectorAll("details[data-folded]")) {
    delete part.dataset.folded;
    part.open = false;
  }
});
