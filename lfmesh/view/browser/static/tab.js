// Names this tab to the server, in the address of its websocket: loaded again, it finds its page as it was left.
(function () {
  const KEY = "lfmesh tab";
  const fresh = () =>
    Array.from(crypto.getRandomValues(new Uint8Array(16)), (byte) => byte.toString(16).padStart(2, "0")).join("");
  try {
    const [entry] = performance.getEntriesByType("navigation");
    let tab = sessionStorage.getItem(KEY);
    // Whoever opens the address anew, in this tab or in another, gets a new page.
    if (!tab || entry.type === "navigate") sessionStorage.setItem(KEY, (tab = fresh()));
    const socket = `${location.protocol === "https:" ? "wss:" : "ws:"}//${location.host}/ws?tab=${tab}`;
    const address = new URL(location);
    address.searchParams.set("sessionURL", socket); // read, and taken out again, by trame's client
    history.replaceState(null, "", address);
  } catch {
    // A browser that keeps nothing for a tab: its page ends with its connection.
  }
})();
