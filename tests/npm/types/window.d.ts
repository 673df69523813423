// What the studio's page has in its window: its own socket, for tests and for a person at the console; and uPlot, a script.
interface Window {
    hexwire: Hexwire;
    uPlot: Untyped;
}

/** What belongs to a library that comes without types: uPlot, and three.js and its parts. */
type Untyped = any;
type Three = Untyped;

/** Who looks at a page: the key of the tab, and whether it may be given control. */
interface Visitor {
    tab: string;
    operates: boolean;
}
