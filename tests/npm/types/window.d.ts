// What the studio's page has in its window: its own socket, for tests and for a person at the console; and uPlot, a script.
interface Window {
    hexwire: any;
    uPlot: any;
}
