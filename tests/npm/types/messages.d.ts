// What the studio tells its pages over their socket, and what its calls answer. Angles are radians unless a comment says
// otherwise. The names and arguments of calls, and answers that Python declares in full, are made of it by calls.py.

type Optional<T> = { [K in keyof T]?: undefined };

// -- messages --------------------------------------------------------------------------------------------------------

interface Joint {
    name: string;
    servo: number;
    min: number;
    max: number;
    speed: number;
}

interface Hello {
    kind: "hello";
    tab: string;
    right: number;
    robot: string;
    joints: Joint[];
    space: boolean;
}

interface Always {
    opened: number;
    opening: string;
    open_error: string;
    refused: string;
}

/** Of an arm or a servo bus. */
interface Present {
    robot: string;
    url: string;
    connected: boolean;
    error: string;
    dialect: number;
    known: boolean;
    /** Seconds since 1970 of what is shown while nothing is known. */
    last: number | null;
    missing: string[];
    unready: string;
    rate: number | null;
    round_trip_ms: number | null;
    faults: string[] | null;
    holder: string;
    holder_tab: string;
    stopped: string;
    stops: number;
    torque: string;
    note: string;
    uncalibrated: string;
}

interface OfArm {
    /** Why the arm holds: a lost lease. */
    lost: string;
    teaching: boolean;
    taught: string | null;
}

interface OfBus {
    baud: number;
    job: string;
    share: number | null;
}

type NothingOpen = Always & { mode: "none" | "opening" } & Optional<Present & OfArm & OfBus>;
type ArmFacts = Always & { mode: "arm" } & Present & OfArm & Optional<OfBus>;
type BusFacts = Always & { mode: "bus" } & Present & OfBus & Optional<OfArm>;
type Facts = NothingOpen | ArmFacts | BusFacts;

/** A frame of state, see studio/frames.py; NaN is what nobody knows. */
interface Frame {
    time: number;
    joints: string[];
    stops: number;
    stopped: boolean;
    tripped: boolean;
    maintenance: boolean;
    held: boolean;
    position: Float32Array;
    velocity: Float32Array;
    load: Float32Array;
    current: Float32Array;
    voltage: Float32Array;
    temperature: Float32Array;
    goal: Float32Array;
    flags: Uint16Array;
    known: boolean[];
}

interface News {
    kind: "news";
    level: string;
    text: string;
}

/** How far a motion to a goal is: seconds. */
interface Run {
    kind: "run";
    title: string;
    elapsed: number;
    duration: number;
    lead_in: number;
    outcome: "succeeded" | "aborted" | "preempted" | null;
    text: string;
    holds: boolean;
    off: string;
}

/** Degrees, degrees per second, percent, volts, amperes. */
interface LiveRow {
    id: number;
    counts: number | null;
    deg: number | null;
    speed: number | null;
    load: number | null;
    volts: number | null;
    celsius: number | null;
    amps: number | null;
    faults: string[];
    error: string;
}

interface Servos {
    kind: "servos";
    t: number;
    rows: LiveRow[];
}

/** How a servo followed a step: degrees, milliseconds, percent. */
interface StepFigures {
    at: number | null;
    size: number | null;
    delay: number | null;
    rise: number | null;
    overshoot: number | null;
    peak: number | null;
    settled: number | null;
    steady_error: number | null;
}

interface WaveEnd {
    end: string;
    servo: number;
    samples: number;
    missed: number;
    off: number;
    steps: StepFigures[];
}

interface Wave extends Partial<WaveEnd> {
    kind: "wave";
    begin?: number;
    /** Seconds, goal and position in degrees, load in percent. */
    rows?: [number, number, number, number][];
}

/** How far a hand has moved a joint: degrees. */
interface RangeRow {
    name: string;
    low: number | null;
    now: number | null;
    high: number | null;
    usual: number | null;
    missing: string;
}

interface Ranges {
    kind: "range";
    rows: RangeRow[];
}

interface StepsTold {
    kind: "steps";
    rows: string[];
}

interface LeaderTold {
    kind: "leader";
    leader: {
        robot: string;
        url: string;
        mirror: boolean;
        error: string;
        stopped: boolean;
        torque: string;
        /** Radians by joint of the follower; null where that is unknown. */
        led: Record<string, number | null>;
    } | null;
}

interface Calibration {
    rows: [string, string, string, string, string][];
    toml: string;
    lerobot: string;
    no_lerobot: string;
}

type Level = "ok" | "warn" | "error" | "";

interface FirstRun {
    kind: "first";
    robot: string;
    url: string;
    hand: string;
    bare: boolean;
    stage: "what" | "calibrated" | "ranges" | "jog" | "done";
    title: string;
    text: string;
    next: string;
    missing: string;
    joint: string;
    joints: string[];
    rows: [string, string, Level][];
    measuring: boolean;
    middle: boolean;
    endless: string[];
    measured: Calibration | null;
    undo: boolean;
}

/** Without `stage` no run was begun. */
type First = FirstRun | ({ kind: "first" } & Optional<Omit<FirstRun, "kind">>);

/** What pages can listen to. */
interface Told {
    frame: Frame;
    facts: Facts;
    hello: Hello;
    link: boolean;
    news: News;
    run: Run;
    servos: Servos;
    wave: Wave;
    range: Ranges;
    steps: StepsTold;
    leader: LeaderTold;
    first: First;
}

/** Whatever comes as JSON. */
type Message =
    | Hello
    | ({ kind: "facts" } & Facts)
    | News
    | Run
    | Servos
    | Wave
    | Ranges
    | StepsTold
    | LeaderTold
    | First
    | { kind: "held"; id: number }
    | { kind: "ended"; id: number | null; why: string; fine?: boolean }
    | { kind: "stopping" }
    | { kind: "answer"; id: number; value: unknown }
    | { kind: "answer"; id: number; error: string };

// -- answers ---------------------------------------------------------------------------------------------------------

/** In place of an answer, where it was refused. */
interface Refused {
    error: string;
}

/** What a browser draws: metres, quaternions x, y, z, w. Its colour is that of a joint, of the theme, or its own. */
interface Shape {
    kind: string;
    size: number[];
    place: number[];
    turn: number[];
    joint?: number;
    colour?: string;
    rgb?: string | number[] | null;
}

/** Of a mesh that pages may load by its number; `size` is its scale. */
interface MeshShape extends Shape {
    mesh: number;
}

/** Angle or way: `multiplier` times the position of joint number `joint`, plus `offset`. */
interface Drive {
    axis: number[];
    joint: number;
    multiplier: number;
    offset: number;
    slides?: boolean;
}

type Link = {
    name: string;
    parent: number;
    place: number[];
    turn: number[];
    shapes: Shape[];
    plain?: Shape[];
    meshes?: MeshShape[];
} & (Drive | Optional<Drive>);

type Theme = "light" | "dark";

/** See studio/geometry.py. */
interface Geometry {
    name: string;
    joints: { name: string; minimum: number; maximum: number }[];
    colours: Record<Theme, Record<string, string>>;
    palette: Record<Theme, string[]>;
    links: Link[];
    tip: number;
    heading: number;
    reach: number;
    /** Why some links are drawn plainly. */
    faults?: string[];
}

interface JointRange {
    name: string;
    min: number;
    max: number;
}

interface ArmValues {
    geometry: Geometry | null;
    joints: JointRange[];
    table: number | null;
    jaws: { joint: string; closed: number; opened: number } | null;
    space: number | null;
    turns: { offset: number; factors: Record<string, number> }[] | null;
    look: Geometry | null;
    emulated: string;
}

interface Branch {
    name: string;
    turn: number;
    why: string;
}

interface Plan {
    goal: Record<string, number>;
    known: boolean;
    duration: number;
    lead_in: number;
    fits: number | null;
    tip: { position: number[]; rpy: number[]; pitch_roll: number[] | null } | null;
    branch: string;
    branches: Branch[];
    refusal: string;
    unready: string;
    trace: number[][];
}

interface Pose {
    name: string;
    angles: Record<string, number>;
    saved: boolean;
}

interface Curves {
    names: string[];
    duration: number;
    times: number[];
    rows: number[][];
}

interface Taught {
    teaching: boolean;
    taught: Curves | null;
}

/** Steps of a program, as in its file: degrees, millimetres, percent, seconds. */
interface PlaceStep {
    place: number[];
    line?: boolean;
    relative?: boolean;
    aim?: string;
    branch?: string;
    rpy?: number[];
    pitch?: number;
    roll?: number;
}

interface PlayStep {
    play: string;
    from?: number;
    to?: number;
    smooth?: number;
    factor?: number;
    fit?: boolean;
}

type MoveStep = ({ pose: string } | { joints: Record<string, number> } | PlaceStep | { grip: number } | PlayStep) & { speed?: number; steps?: undefined };
type PlainStep = MoveStep | ({ wait: number } | { ask: string }) & { speed?: undefined; steps?: undefined };
type Step = PlainStep | { repeat: number; steps: Step[]; speed?: undefined };

interface Checked {
    number: string;
    duration: number;
    refusal: string;
    fits: number | null;
}

interface Port {
    device: string;
    guess: string;
    robots: string[];
    obstacle: string;
    advice: string;
}

interface Ports {
    plugged: Port[] | null;
    emulated: Port[];
    robots: string[];
    default: string;
    warning: string;
}

interface FleetArm {
    name: string;
    url: string;
    own: boolean;
    robot: string;
    host: string;
    holder: string;
    torque: string;
    stopped: boolean;
    why: string;
    age: number | null;
    silent: boolean;
    known: boolean;
    faults: string;
}

/** Value and words. */
type Choice<T> = [T, string];

interface Register {
    name: string;
    note: string;
    words: string;
    value: string;
    exact: string;
    unit: string;
    raw: string;
    range: string;
    exact_range: string;
    raw_range: string;
    factory: string;
    backup: string;
    kept: string;
    stored: boolean;
    address: string;
    why_not: string;
    differs: string[];
}

interface Registers {
    rows: Register[];
    undo: string;
}

/** What was written, or what is to be asked before. */
interface Edited {
    told?: string;
    question?: string;
}

interface Backup {
    servos: number[];
    file: string;
}

interface Compared {
    servo: number;
    title: string;
    /** Register, value here, value there; null if the servo is not here. */
    differences: [string, number | null, number | null][] | null;
}

interface Servo {
    id: number;
    usable: boolean;
    model: string;
    more: string;
    level: "ok" | "warn" | "error";
    remarks: { text: string; bad: boolean }[];
    facts: [string, string][];
}

interface ServoList {
    rates: Choice<number>[];
    rate: string;
    servos: Servo[];
    elsewhere: [number, number[]][];
}

interface SetUp {
    joint: string;
    text: string;
    found: string;
    blocked: string;
    warning: string;
    question: string;
    joints: [string, string][];
    remarks: string[];
}

interface Recording {
    name: string;
    size: number;
    changed: number;
    begin: number;
    duration: number;
    states: number;
    joints: string[];
    topics: string[];
    cameras: string[];
    robot: string;
    traffic: number;
    problem: string;
    recoverable: boolean;
    /** Whether the open arm has its joints. */
    fits: boolean;
    /** The emulated arm that can play it; empty if none can. */
    twin: string;
}

interface Recorder {
    name: string;
    seconds: number;
    states: number;
    lost: number;
    pictures: number;
    size: number;
    problems: Record<string, string>;
    ended: string;
}

interface TwinState {
    robot: string;
    title: string;
    running: boolean;
    elapsed: number;
    duration: number;
    lead_in: number;
    began: number;
    ended: string;
    arrived: boolean;
}

interface RecordingList {
    remark: string;
    entries: Recording[];
    folder: string;
    largest: number;
    recorder: Recorder;
    twin: TwinState & { busy: boolean };
    cameras: string[];
    robot: string;
}

/** Number, time, sent, kind, size, text, problem, bad, number of its request, milliseconds after that. */
type WireRow = [number, number, number, string, number, string, string, number, number | null, number | null];

interface WireRows {
    rows: WireRow[];
    answers: [number, number][];
    next: number;
    more: boolean;
    first: number;
    newest: number;
    span: number;
    skipped?: number;
    id: string;
    view: "live" | "file";
    name: string;
    series: string;
    note: string;
    offset: number;
}

/** A layer or field of a frame, and its bytes. */
interface WirePart {
    name: string;
    start: number;
    end: number;
    words?: string;
    meaning?: string;
    problem?: string;
    value?: number;
    parts?: WirePart[];
}

interface WireFrame {
    number: number;
    row: WireRow;
    hex: string;
    tree: WirePart;
    answered: number | null;
    took: number | null;
}

/** Heads of columns of numbers, by their address. */
interface Heads {
    "/data/history": object;
    "/data/recording": { names: string[]; begin: number; problem: string };
    "/data/compare": {
        names: string[];
        lag: number;
        joints: { name: string; rms: number | null; largest: number | null; at: number | null }[];
        left_out: string[];
    };
    "/data/twin": { names: string[]; state: TwinState };
}

/** Answers of which Python says no more than that they are tables. */
interface Values {
    "arm.values": ArmValues;
    "arm.preview": Plan;
    "arm.poses": Pose[];
    "arm.save_pose": Pose[];
    "arm.rename_pose": Pose[];
    "arm.remove_pose": Pose[];
    "arm.taught": Taught;
    "arm.timeline": Curves;
    "arm.leaders": { ports: Port[]; emulated: string; robots: string[]; robot: string };
    "arm.program": Step[];
    "arm.check_program": Checked[];
    cameras: { name: string; device: string; problem: string }[];
    ports: Ports;
    "ports.known": Ports;
    "fleet.arms": { arms: FleetArm[]; gone: string[]; looking: boolean; router: string; note: string; error: string };
    "calibration.arms": { arms: Choice<string>[]; likely: string };
    "calibration.work": Calibration;
    "first.look": First;
    "first.shape": Geometry | null;
    "backup.take": Backup;
    "backup.differences": Compared[];
    "registers.read": Registers;
    "registers.edit": Edited;
    "board.registers": Registers;
    "board.edit": Edited;
    "board.backup": Backup;
    "board.differences": Compared[];
    "board.servos": { bare: boolean; joints: { name: string; servo: number }[] };
    "board.ask": { servos: string[][]; firmware: string; counters: [string, string][] };
    /** Seconds before now, volts, degrees Celsius, amperes, percent. */
    "health.rows": { now: number; rows: [number, ...(number | null)[]][] };
    recordings: RecordingList;
    "recordings.geometry": { geometry: Geometry | null };
    "servos.list": ServoList;
    "identity.rates": { here: number; rates: Choice<number>[] };
    "identity.look": { servo: number; told: string };
    "stress.run": { facts: [string, string][]; bins: [string, number][]; missing: [string, string][] };
    "set_up.choices": { arms: Choice<string>[]; roles: Choice<string>[] };
    "set_up.look": SetUp;
    "slide.range": { min: number; max: number };
    "wire.frame": WireFrame;
    "wire.rows": WireRows;
}

/** Answers to files that are sent. */
interface Sent {
    backup: { servos: number[] };
    calibration: Calibration;
}
