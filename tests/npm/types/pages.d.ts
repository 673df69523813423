// What modules of the studio give each other, where it is said here better than there: a page is not sent its types.

// -- live.js ---------------------------------------------------------------------------------------------------------

/** Ends with what it returns, or with the element. */
type Listen<K extends keyof Told> = (call: (value: Told[K]) => unknown, element?: Element) => () => void;

type Listeners = { [K in keyof Told]: Set<{ call: (value: Told[K]) => unknown; element?: Element }> };

interface HoldOptions {
    /** It lasts while the page is in sight, without a pressed button. */
    attended?: boolean;
    /** What is pressed. */
    element?: HTMLElement;
}

interface ButtonOptions extends HoldOptions {
    /** Whether a press does something else now. */
    idle?: () => unknown;
    onEnd?: (why: string) => void;
}

/** A hold: `args` once they have changed, `fine` once it ended as it was asked for. */
interface Held {
    number: number;
    args?: object;
    settle: (why: string) => void;
    attended: boolean;
    element: HTMLElement | null;
    timer: number;
    fine?: boolean;
}

/** Ask for something by its name in studio/calls.py; `opened`: `facts.opened` of what is shown, if it is about that. */
interface Ask {
    <N extends keyof Calls>(name: N, args?: Calls[N]["args"], opened?: number | null): Promise<Calls[N]["answer"]>;
}

/** As `Ask`; undefined if it was refused, which a person was told then. */
interface Act {
    <N extends keyof Calls>(name: N, args?: Calls[N]["args"], opened?: number | null): Promise<Calls[N]["answer"] | undefined>;
}

interface Hexwire {
    model: Hello;
    facts: Facts | null;
    frame: Frame | null;
    tab: string;
    key: string;
    operates: boolean;
    readonly connected: boolean;
    readonly heard: boolean;
    readonly known: boolean;
    readonly holding: boolean;
    readonly attending: boolean;
    onFrame: Listen<"frame">;
    onFacts: Listen<"facts">;
    onHello: Listen<"hello">;
    onNews: Listen<"news">;
    onRun: Listen<"run">;
    onLink: Listen<"link">;
    onServos: Listen<"servos">;
    onWave: Listen<"wave">;
    onRange: Listen<"range">;
    onFirst: Listen<"first">;
    onSteps: Listen<"steps">;
    onLeader: Listen<"leader">;
    call: Ask;
    act: Act;
    /** Hold a motion until `release`; resolves with why it ended. */
    hold: (kind: string, args: object, options?: HoldOptions) => Promise<string>;
    /** Change what is held. */
    update: (args: object) => void;
    release: (why?: string) => void;
    holdButton: (element: HTMLButtonElement, kind: string, args: object | (() => object), options?: ButtonOptions) => void;
    stop: () => void;
    say: (text: string, urgent?: boolean) => void;
    hint: (text: string, element: HTMLElement) => void;
    notify: (text: string, level?: string) => void;
}

// -- finding elements ------------------------------------------------------------------------------------------------

type Kind<E extends Element> = new () => E;
type Find = <E extends Element = HTMLElement>(root: ParentNode, selector: string, kind?: Kind<E>) => E;

// -- arm.js ----------------------------------------------------------------------------------------------------------

/** What is shown beside the arm. */
type Way = "drive" | "teach" | "program" | "leader";
/** A part of Jog and go. */
type Part = "joints" | "space" | "grip" | "goto" | "poses";

type Args = { joints: JointRange[] } & Partial<ArmValues>;

/** What a row of a joint shows. */
type Drawn = { [K in "position" | "goal" | "load" | "flags"]: ArrayLike<number> };

/** What the parts of a page about joints tell each other. */
interface PageEvents {
    draw: Drawn;
    facts: Facts;
    speed: number;
    taught: Taught;
    need: null;
    way: Way;
    run: Run;
    elapsed: { run: Run; now: number };
}

type PageListeners = { [K in keyof PageEvents]: ((value: PageEvents[K]) => unknown)[] };

interface ArmPage {
    root: HTMLElement;
    args: Args;
    view: import("./arm3d.js").Arm3D | null;
    plan: Plan | Refused | null;
    mine: boolean;
    unready: string;
    speed: number;
    hidden: number;
    lost: number;
    step: number;
    find: (selector: string) => HTMLElement | null;
    get: <E extends Element = HTMLElement>(selector: string, kind?: Kind<E>) => E;
    all: <E extends Element = HTMLElement>(selector: string, kind?: Kind<E>) => E[];
    on: <K extends keyof PageEvents>(name: K, act: (value: PageEvents[K]) => unknown) => void;
    tell: <K extends keyof PageEvents>(name: K, value: PageEvents[K]) => void;
    call: <N extends keyof Calls>(name: N, args?: Calls[N]["args"]) => Promise<Calls[N]["answer"] | Refused>;
    tellTaught: () => Promise<void>;
    run: (values: Record<string, unknown>) => Promise<string>;
    jog: (joint: string, turn: number) => [string, object];
    drag: (joint: string, goal: number) => [string, object];
    attend: () => () => string;
    ghost: (goal: Record<string, number> | null, trace?: number[][] | null) => void;
    positions: () => number[] | Float32Array | null;
    knows: (i: number) => boolean;
}

// -- arm3d.js --------------------------------------------------------------------------------------------------------

/** Radians in the order of the arm's joints, or by name. */
type Joints = number[] | Float32Array | Float64Array | Record<string, number>;

interface TipPose {
    position: number[];
    quaternion?: number[];
}

/** An arm that is drawn. */
interface Figure {
    root: Three;
    frames: Three[];
    shades: [Three, Three, number][];
    bodies: Three[];
    joints: number[] | null;
    lost?: string;
}

type Look = Record<"sky" | "ground" | "floor" | "minor" | "major" | "text" | "shadow" | "lost" | "trace" | "ghost", string> &
    Record<"key" | "fill", number>;

interface ViewOptions {
    theme?: Theme | "auto";
    label?: string;
    traceColour?: string;
    palette?: Record<Theme, string[]>;
}

/** Flat lists, three numbers for each corner. */
type Surface = Record<"position" | "normal" | "color", Float32Array>;
