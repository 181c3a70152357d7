// What viser's page lacks: it is as dark as other pages, the key "?" opens the list of commands and keys, and buttons without text have names.

if (matchMedia("(prefers-color-scheme: dark)").matches) {
  const address = new URL(location);
  address.searchParams.set("darkMode", ""); // read by viser when the page is built
  history.replaceState(null, "", address);
}

addEventListener("keydown", (event) => {
  if (event.key !== "?" || event.target.closest?.("input, textarea")) return;
  document.documentElement.dispatchEvent(new KeyboardEvent("keydown", { key: "k", code: "KeyK", ctrlKey: true, bubbles: true }));
});

const NAMES = { "mantine-Notification-closeButton": "Close the message", "mantine-Modal-close": "Close" };

new MutationObserver(() => {
  document.getElementById("root").setAttribute("role", "main");
  for (const button of document.querySelectorAll("button:not([aria-label])")) {
    if (button.textContent.trim() !== "" || button.labels?.length) continue;
    const known = Object.keys(NAMES).find((name) => button.classList.contains(name));
    button.setAttribute("aria-label", NAMES[known] ?? (button.dataset.testid || "Options of the panel"));
  }
}).observe(document.documentElement, { childList: true, subtree: true });
