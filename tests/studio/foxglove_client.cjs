// Foxglove's own client on the socket of a studio. Prints what it was told, and the first messages of each topic,
// compared with Foxglove's own schemas. Arguments: address, messages of each topic to wait for, topics.
const { FoxgloveClient } = require("@foxglove/ws-protocol");
const schemas = require("@foxglove/schemas/jsonschema");
const Ajv = require("ajv");
const { WebSocket } = require("ws");

const [url, most, ...topics] = process.argv.slice(2);
const ajv = new Ajv({ strict: false });
const found = { info: null, topics: {}, messages: {}, faults: [], statuses: [] };
const client = new FoxgloveClient({ ws: new WebSocket(url, ["foxglove.sdk.v1"]) });
const channels = new Map();
let done = false;

client.on("error", (error) => {
    console.error(String(error));
    process.exit(1);
});
client.on("serverInfo", (info) => {
    found.info = info;
    // What nobody was offered: each is answered, none does anything.
    client.advertise({ topic: "/joint_targets", encoding: "json", schemaName: "foxglove.JointStates" });
    client.setParameters([{ name: "torque", value: true }]);
});
client.on("status", (status) => found.statuses.push(status.message));
client.on("advertise", (rows) => {
    for (const row of rows) {
        found.topics[row.topic] = row.schemaName;
        if (topics.includes(row.topic)) {
            channels.set(client.subscribe(row.id), row);
        }
    }
});
client.on("message", ({ subscriptionId, timestamp, data }) => {
    const { topic, schemaName } = channels.get(subscriptionId);
    const body = JSON.parse(new TextDecoder().decode(data));
    const check = ajv.compile(schemas[schemaName.replace("foxglove.", "")]);
    if (!check(body)) {
        found.faults.push([topic, ajv.errorsText(check.errors)]);
    }
    const kept = (found.messages[topic] ??= []);
    if (kept.length < Number(most)) {
        kept.push({ ns: String(timestamp), body });
    }
    const enough = (name) => (found.messages[name] ?? []).length >= (name.endsWith("/scene") ? 1 : Number(most));
    if (!done && topics.every(enough)) {
        done = true;
        process.stdout.write(JSON.stringify(found), () => process.exit(0));
    }
});
