-- SPDX-License-Identifier: GPL-2.0-or-later
--
-- Wireshark dissector for hexwire: session header, command frames of both dialects, servo packets.
-- Dissects TCP, UDP and serial captures (link type USER0, 147). Names and layouts come from hexwire_tables.lua,
-- which `make analyzers` writes and which must stand beside this file. It is the only other
-- file to copy into the folder of Wireshark's plugins.

local here = __DIR__ or (debug.getinfo(1, "S").source:match("^@(.*[/\\])") or "./")
if not here:match("[/\\]$") then here = here .. "/" end
if not hexwire_tables then dofile(here .. "hexwire_tables.lua") end
local T = hexwire_tables

local SYNC = "\90\250\250\90"
local TAIL = "\13\10"
local COOKED = "\10\10"
local HEAD_SIZE = 40
local OVERHEAD = 44
local SILENCE = 0.050 -- seconds after which an unfinished frame is given up
local PATIENCE = 2 -- seconds in which an answer may come
local SAMPLE = 24 -- bytes shown of a body that is only bytes

local proto = Proto("hexwire", "hexwire robot arm protocol")

local F = {
  reading = ProtoField.string("hexwire.reading", "Reading"),
  kind = ProtoField.string("hexwire.kind", "Kind"),
  sync = ProtoField.uint32("hexwire.sync", "Sync word", base.HEX),
  time_sec = ProtoField.uint32("hexwire.time_sec", "Sender's clock, seconds"),
  time_nsec = ProtoField.uint32("hexwire.time_nsec", "Sender's clock, nanoseconds"),
  sn = ProtoField.uint32("hexwire.sn", "Serial number"),
  src = ProtoField.int32("hexwire.src", "Source module", base.DEC, T.modules),
  dst = ProtoField.int32("hexwire.dst", "Destination module", base.DEC, T.modules),
  type = ProtoField.int32("hexwire.type", "Type"),
  size = ProtoField.uint32("hexwire.size", "Size of the frame"),
  flag = ProtoField.uint8("hexwire.flag", "Flag", base.HEX),
  dialect = ProtoField.uint8("hexwire.dialect", "Dialect"),
  seq = ProtoField.uint8("hexwire.seq", "Sequence number"),
  pad = ProtoField.uint8("hexwire.pad", "Pad bytes"),
  len = ProtoField.uint16("hexwire.len", "Length of the body"),
  cmd = ProtoField.uint8("hexwire.cmd", "Command", base.HEX),
  name = ProtoField.string("hexwire.command", "Command name"),
  ext = ProtoField.uint8("hexwire.cmd_ext", "Extension", base.HEX),
  reply = ProtoField.bool("hexwire.reply", "Reply", 8, nil, 0x80),
  report = ProtoField.bool("hexwire.report", "Unsolicited", 8, nil, 0x40),
  status = ProtoField.uint8("hexwire.status", "Status", base.DEC, T.statuses, 0x3F),
  body = ProtoField.bytes("hexwire.body", "Body"),
  item = ProtoField.string("hexwire.body.text", "Fields"),
  check = ProtoField.uint16("hexwire.check", "Check", base.HEX),
  tail = ProtoField.bytes("hexwire.tail", "Tail"),
  garbage = ProtoField.bytes("hexwire.garbage", "Bytes that belong to no frame"),
  request = ProtoField.framenum("hexwire.response_to", "Answers the request in", base.NONE, frametype.REQUEST),
  response = ProtoField.framenum("hexwire.response_in", "Answered in", base.NONE, frametype.RESPONSE),
  took = ProtoField.double("hexwire.response_time", "Time from the request (s)"),
  servo_id = ProtoField.uint8("hexwire.servo.id", "Servo"),
  servo_len = ProtoField.uint8("hexwire.servo.length", "Length"),
  inst = ProtoField.uint8("hexwire.servo.instruction", "Instruction", base.HEX, T.instructions),
  error = ProtoField.uint8("hexwire.servo.error", "Error", base.HEX),
  params = ProtoField.bytes("hexwire.servo.params", "Parameters"),
  servo_text = ProtoField.string("hexwire.servo.text", "Servo packet"),
  checksum = ProtoField.uint8("hexwire.servo.checksum", "Checksum", base.HEX),
  message = ProtoField.uint16("hexwire.fragment.message", "Message"),
  index = ProtoField.uint16("hexwire.fragment.index", "Chunk"),
  chunks = ProtoField.uint16("hexwire.fragment.count", "Chunks"),
  whole = ProtoField.string("hexwire.fragment.reading", "Reassembled message"),
  whole_size = ProtoField.uint32("hexwire.fragment.size", "Bytes of the message"),
}
local fields = {}
for _, field in pairs(F) do fields[#fields + 1] = field end
proto.fields = fields

local X = {
  bad_check = ProtoExpert.new("hexwire.bad_check", "Wrong check", expert.group.CHECKSUM, expert.severity.ERROR),
  bad_frame = ProtoExpert.new("hexwire.bad_frame", "Bad frame", expert.group.MALFORMED, expert.severity.ERROR),
  bad_sum = ProtoExpert.new("hexwire.bad_checksum", "Wrong checksum of a servo packet", expert.group.CHECKSUM,
    expert.severity.ERROR),
  garbage = ProtoExpert.new("hexwire.noise", "Bytes that belong to no frame", expert.group.UNDECODED,
    expert.severity.WARN),
  cooked = ProtoExpert.new("hexwire.cooked", "The port was left with ICRNL", expert.group.MALFORMED,
    expert.severity.WARN),
  marker = ProtoExpert.new("hexwire.hazard.marker", "0D 0A inside the frame: a board of the chapter cuts it here",
    expert.group.PROTOCOL, expert.severity.WARN),
  ceiling = ProtoExpert.new("hexwire.hazard.ceiling", "Run time in the current ceiling of an HLS servo",
    expert.group.PROTOCOL, expert.severity.WARN),
  refused = ProtoExpert.new("hexwire.refused", "The request was refused or failed", expert.group.RESPONSE_CODE,
    expert.severity.NOTE),
  body = ProtoExpert.new("hexwire.bad_body", "The body does not fit the command", expert.group.MALFORMED,
    expert.severity.ERROR),
}
local experts = {}
for _, info in pairs(X) do experts[#experts + 1] = info end
proto.experts = experts

proto.prefs.tcp_port = Pref.uint("TCP port", 15030, "Port whose TCP traffic is hexwire; 0 for none")
proto.prefs.udp_port = Pref.uint("UDP port", 15030, "Port whose UDP traffic is hexwire; 0 for none")
proto.prefs.series = Pref.string("Servo series", "board",
  "Series of all servos (seven_bot, scs, sts_sms, hls), or board: as on the Hex7Bot's")

proto.prefs.line = Pref.string("Serial line", "auto",
  "What serial captures hold: host (command frames), bus (bare servo packets), or auto: bus if it begins with one")

-- Bytes ----------------------------------------------------------------------------------------------------------

local function u16(data, at) -- little-endian, `at` counts from 0
  local low, high = data:byte(at + 1, at + 2)
  return low + high * 256
end

local function u32(data, at) return u16(data, at) + u16(data, at + 2) * 65536 end

local function i32(data, at)
  local value = u32(data, at)
  return value >= 2147483648 and value - 4294967296 or value
end

local function hex(data, limit)
  local shown = data:sub(1, limit or #data)
  local text = shown:gsub(".", function(c) return string.format("%02X ", c:byte()) end):sub(1, -2)
  return #shown < #data and text .. " ..." or text
end

local function frame_check(data) -- CRC-16/IBM-3740; FFFF goes as 0000
  local crc = 0xFFFF
  for i = 1, #data do
    crc = bit.bxor(crc, data:byte(i) * 256)
    for _ = 1, 8 do
      crc = crc >= 0x8000 and bit.band(bit.bxor(crc * 2, 0x1021), 0xFFFF) or crc * 2
    end
  end
  return crc == 0xFFFF and 0 or crc
end

local function servo_sum(data, from, to) -- bytes from..to, counted from 1
  local sum = 0
  for i = from, to do sum = sum + data:byte(i) end
  return 255 - sum % 256
end

-- Finding frames -------------------------------------------------------------------------------------------------

-- Judges what stands at `at` (from 0) and begins with the sync word. Returns a kind and the bytes it takes:
-- "head" (no header), "more" (and how many are wanted), "frame", "cooked", or "bad" and a reason.
local function examine(data, at)
  local available = #data - at
  if available < HEAD_SIZE then return "more", HEAD_SIZE end
  local size, flag, dialect = u32(data, at + 28), data:byte(at + 33), data:byte(at + 34)
  local pad, len = data:byte(at + 36), u16(data, at + 36)
  if size > T.max_frame or flag ~= 0x82 or (dialect ~= 1 and dialect ~= 2) then return "head" end
  if size ~= OVERHEAD + len + pad or pad ~= -len % 4 then return "head" end
  if available < size then return "more", size end
  local tail = data:sub(at + size - 1, at + size)
  if tail ~= TAIL and tail ~= COOKED then
    return "bad", size, string.format("tail is %s, not 0D 0A", hex(tail))
  end
  local check = u16(data, at + HEAD_SIZE + len)
  if dialect == 2 then
    local wanted = frame_check(data:sub(at + 1, at + HEAD_SIZE + len))
    if check ~= wanted then
      if tail == COOKED then return "bad", size, "tail is 0A 0A, not 0D 0A" end
      return "bad", size, string.format("check is %04X, not %04X", check, wanted)
    end
  end
  return tail == COOKED and "cooked" or "frame", size
end

-- Cuts frames. Returns items {kind, from, to (exclusive), reason}, where the unfinished rest begins, and how many
-- bytes it wants. With `final` nothing stays unfinished.
local function cut_frames(data, final)
  local items, done, at = {}, 0, 0
  local function add(kind, from, to, reason)
    if from > done then items[#items + 1] = {kind = "garbage", from = done, to = from} end
    items[#items + 1] = {kind = kind, from = from, to = to, reason = reason}
    done, at = to, to
  end
  while true do
    local start = data:find(SYNC, at + 1, true)
    if not start then
      local keep = 0
      if not final then
        for n = 1, 3 do if data:sub(-n) == SYNC:sub(1, n) then keep = n end end
      end
      local rest = math.max(#data - keep, done)
      if rest > done then items[#items + 1] = {kind = "garbage", from = done, to = rest} end
      return items, rest, 4
    end
    start = start - 1
    local kind, size, reason = examine(data, start)
    if kind == "head" then
      at = start + 1
    elseif kind == "more" and not final then
      if start > done then items[#items + 1] = {kind = "garbage", from = done, to = start} end
      return items, start, size
    elseif kind == "more" or kind == "bad" then
      local last = kind == "more" and #data or start + size
      local following = data:find(SYNC, start + 2, true)
      if following and following - 1 < last then last = following - 1 end
      reason = reason or string.format("cut short, %d of %d bytes", #data - start, size)
      add("bad", start, last, reason)
    else
      add(kind, start, start + size)
    end
  end
end

-- The same for servo packets.
local function cut_packets(data, final)
  local items, done, at = {}, 0, 0
  local function next_header(from) -- from 0; where a header may begin, or nil
    local found = data:find("\255[\255\245]", from + 1)
    return found and found - 1
  end
  while true do
    local start = next_header(at)
    if not start then
      local keep = (not final and data:sub(-1) == "\255") and 1 or 0
      local rest = math.max(#data - keep, done)
      if rest > done then items[#items + 1] = {kind = "garbage", from = done, to = rest} end
      return items, rest, 6
    end
    local second, id, len = data:byte(start + 2, start + 4)
    local available, size = #data - start, 6
    if len then size = 4 + len end
    local quirk = len == 6 and second == 245 and available >= 6 and
      data:byte(start + 6) == servo_sum(data, start + 3, start + 5)
    if quirk then size = 6 end
    if (id == 255 and second == 255) or (len and (len < 2 or len > 246)) then
      at = start + 1
    else
      local kind, last, reason = "packet", start + size, nil
      if available < size then
        if not final then
          if start > done then items[#items + 1] = {kind = "garbage", from = done, to = start} end
          return items, start, size
        end
        kind, reason, last = "bad_packet", string.format("cut short, %d of %d bytes", available, size), #data
      else
        local got, wanted = data:byte(last), servo_sum(data, start + 3, last - 1)
        if got ~= wanted then
          kind, reason = "bad_packet", string.format("checksum %02X, not %02X", got, wanted)
        end
      end
      if kind == "bad_packet" then
        local following = next_header(start + 2)
        if following and following < last then last = following end
      end
      if start > done then items[#items + 1] = {kind = "garbage", from = done, to = start} end
      items[#items + 1] = {kind = kind, from = start, to = last, reason = reason}
      done, at = last, last
    end
  end
end

-- Words ----------------------------------------------------------------------------------------------------------

local function series_of(id)
  local fixed = proto.prefs.series
  if fixed ~= "board" and T.series[fixed] then return fixed end
  return T.joints[id]
end

local function register_name(series, address)
  local row = series and T.series[series].registers[address]
  return row and row[1] or string.format("0x%02X", address)
end

-- Values of the registers from `address` on. `order` overrides the series' byte order.
local function values(series, address, data, order)
  if not series then return hex(data) end
  order = order or T.series[series].byte_order
  local words, at = {}, 0
  while at < #data do
    local row = T.series[series].registers[address + at]
    if not row or at + row[2] > #data then
      words[#words + 1] = string.format("0x%02X %d", address + at, data:byte(at + 1))
      at = at + 1
    else
      local raw = data:byte(at + 1)
      if row[2] == 2 then
        local second = data:byte(at + 2)
        raw = order == "little" and raw + second * 256 or raw * 256 + second
      end
      local sign = row[3] >= 0 and 2 ^ row[3] or nil
      if sign and raw % (2 * sign) >= sign then raw = -(raw % sign) end
      local text = string.format("%s %d", row[1], raw)
      if row[5] ~= 0 then
        text = text .. string.format(" = %.6g %s", raw * row[5], row[4] == "count" and "deg" or row[4])
      end
      words[#words + 1] = text
      at = at + row[2]
    end
  end
  return table.concat(words, ", ")
end

local function ceiling(series, address, data)
  return series == "hls" and address == 42 and #data == 4
end

-- A servo packet in words, given as its whole bytes. `asked`: bytes of the request it may answer. `where`: on_bus,
-- from_board or to_board; `order`: of the values of a sync write. Returns words, whether it is an answer, a hazard.
local function servo_words(data, asked, where, order)
  local legacy, id, inst = data:byte(2) == 245, data:byte(3), data:byte(5)
  local params = data:sub(6, -2)
  local answer = legacy or where == "from_board" or
    (where == "on_bus" and (not T.instructions[inst] or (T.bare[inst] and #params > 0)))
  if where == "on_bus" and asked and not answer and T.replies[asked:byte(5)] ~= "never" and data ~= asked then
    local reads = (asked:byte(5) == 2 or asked:byte(5) == 130) and #asked > 7
    local wanted = reads and asked:byte(7) + 6 or 6
    local same = asked:byte(3) == id or (asked:byte(5) == 130 and asked:sub(8, -2):find(string.char(id), 1, true) ~= nil)
    answer = same and #data == wanted
  end
  if answer then
    local named = T.board_errors[inst]
    if where == "from_board" and legacy and named then
      local silent = inst == 1 and #data == 8 and params == "\0\0"
      if silent or (inst ~= 1 and #params == 0 and (id == 255 or named == "ping silent")) then
        return "board error " .. named .. (id == 255 and "" or ", servo " .. id), true
      end
    end
    local text = "status " .. id .. (legacy and " legacy" or "")
    if inst ~= 0 then
      local words = {}
      for _, mask in ipairs({1, 2, 4, 8, 32}) do
        if bit.band(inst, mask) ~= 0 and T.status_bits[mask] then words[#words + 1] = T.status_bits[mask] end
      end
      text = text .. " error " .. (#words > 0 and table.concat(words, ", ") or string.format("0x%02X", inst))
    end
    if #params > 0 then
      local reads = asked and #asked > 6 and (asked:byte(5) == 2 or asked:byte(5) == 130)
      local series = series_of(id) or (legacy and "seven_bot") or nil
      if reads and series then
        -- The board swaps the two bytes of a legacy servo's answer.
        local swapped = where == "from_board" and series == "seven_bot" and #params == 2 and order ~= "bus"
        text = text .. ": " .. values(series, asked:byte(6), params, swapped and "little" or nil)
      else
        text = text .. ": " .. hex(params)
      end
    end
    return text, true
  end
  local name = T.instructions[inst] or string.format("instruction 0x%02X", inst)
  local who = id == 254 and "all" or tostring(id)
  local series, address = series_of(id), params:byte(1)
  if inst == 2 and #params == 2 then
    return string.format("read %s: %s, %d bytes", who, register_name(series, address), params:byte(2)), false
  elseif (inst == 3 or inst == 4) and #params > 1 then
    local rest = params:sub(2)
    local words = series and values(series, address, rest) or string.format("0x%02X %s", address, hex(rest))
    return string.format("%s %s: %s", name, who, words), false, ceiling(series, address, rest)
  elseif inst == 130 and #params > 2 then
    local ids = {}
    for i = 3, #params do ids[#ids + 1] = tostring(params:byte(i)) end
    local register = register_name(series_of(params:byte(3)), address)
    return string.format("sync read %s: %s, %d bytes", table.concat(ids, " "), register, params:byte(2)), false
  elseif inst == 131 and #params > 2 and (#params - 2) % (params:byte(2) + 1) == 0 then
    local rows, hazard, step = {}, false, params:byte(2) + 1
    for i = 3, #params, step do
      local each, rest = params:byte(i), params:sub(i + 1, i + step - 1)
      local its = series_of(each)
      hazard = hazard or ceiling(its, address, rest)
      local words = its and values(its, address, rest, order) or string.format("0x%02X %s", address, hex(rest))
      rows[#rows + 1] = string.format("%d %s", each, words)
    end
    return "sync write: " .. table.concat(rows, "; "), false, hazard
  end
  return name .. " " .. who .. (#params > 0 and ": " .. hex(params) or ""), false
end

local function servo_is_sound(data)
  if #data < 6 or data:byte(1) ~= 255 or (data:byte(2) ~= 255 and data:byte(2) ~= 245) then
    return false, "no header"
  end
  local quirk = data:byte(2) == 245 and #data == 6 and data:byte(4) == 6
  if data:byte(4) ~= #data - 4 and not quirk then return false, "length " .. data:byte(4) end
  local got, wanted = data:byte(#data), servo_sum(data, 3, #data - 1)
  if got ~= wanted then return false, string.format("checksum %02X, not %02X", got, wanted) end
  return true
end

local SIZES = {u8 = 1, i8 = 1, u16 = 2, i16 = 2, u32 = 4, i32 = 4}

local function integer(data, at, kind)
  local size, value = SIZES[kind], 0
  for i = size, 1, -1 do value = value * 256 + data:byte(at + i) end
  if kind:sub(1, 1) == "i" and value >= 2 ^ (8 * size - 1) then value = value - 2 ^ (8 * size) end
  return value
end

-- The fields of one row. Returns words and where they end, or nil if the bytes are too few.
local function row_words(data, at, row, known, mask)
  local words = {}
  for _, field in ipairs(row) do
    local name, kind, wanted = field[1], field[2], field[3]
    if wanted == "" or bit.band(mask, T.state_fields[wanted]) ~= 0 then
      if kind == "bytes" then
        words[#words + 1] = name .. " " .. hex(data:sub(at + 1), SAMPLE)
        at = #data
      else
        if at + SIZES[kind] > #data then return nil end
        known[name] = integer(data, at, kind)
        words[#words + 1] = string.format("%s %d", name, known[name])
        at = at + SIZES[kind]
      end
    end
  end
  return table.concat(words, ", "), at
end

-- A body in words by the layout of its command, or nil if it does not fit.
local function body_words(data, layout)
  local known = {}
  local text, at = row_words(data, 0, layout.fields, known, 0)
  if not text then return nil end
  local mask, rows, number = known.fields or 0, {}, known[layout.count]
  if #layout.rows > 0 then
    while at < #data and (not number or #rows < number) do
      local words, last = row_words(data, at, layout.rows, {}, mask)
      if not words or last == at then return nil end
      rows[#rows + 1], at = "(" .. words .. ")", last
    end
    if number and #rows ~= number then return nil end
  end
  if at ~= #data then return nil end
  if #rows > 0 then text = text .. (text ~= "" and " " or "") .. table.concat(rows, " ") end
  return text
end

-- A whole frame in words: fills `out` with what the tree shows.
local function frame_words(data, asked, out)
  local dialect, seq, cmd, ext = data:byte(34), data:byte(35), data:byte(39), data:byte(40)
  local body = data:sub(HEAD_SIZE + 1, HEAD_SIZE + u16(data, 36))
  local row = T.commands[cmd]
  out.name = row and row.name or string.format("command 0x%02X", cmd)
  local reply, report = dialect == 2 and ext >= 128, dialect == 2 and bit.band(ext, 64) ~= 0
  local status = bit.band(ext, 63)
  local text = dialect .. " " .. out.name
  if dialect == 2 then
    local said = T.statuses[status] or "status " .. status
    text = text .. (reply and " reply " .. said or report and " report" or " request")
  end
  text = text .. " seq " .. seq
  local from_board = reply or (dialect == 1 and i32(data, 16) == T.board_module)
  out.from_board = from_board
  if #body > 0 then
    local packet, prefix = nil, ""
    if cmd <= 3 then
      packet = body
    elseif cmd == 26 then
      packet = body
      if not reply then
        prefix = #body >= 2 and string.format("reply_length %d, timeout_ms %d; ", body:byte(1, 2)) or ""
        packet = body:sub(3)
      end
    end
    if packet then
      local sound, reason = servo_is_sound(packet)
      if sound then
        local order = cmd == 3 and "little" or cmd == 26 and from_board and "bus" or nil
        local words, _, hazard = servo_words(packet, asked, from_board and "from_board" or "to_board", order)
        text = text .. ": " .. prefix .. words
        out.packet, out.packet_at, out.ceiling = packet, HEAD_SIZE + #body - #packet, hazard
      else
        text = text .. string.format(": %sbad packet, %s: %s", prefix, reason, hex(packet, SAMPLE))
        out.bad_packet = reason
      end
    else
      local layout = row and ((reply or report) and row.reply or row.request)
      local words = layout and body_words(body, layout)
      text = text .. ": " .. (words or hex(body, SAMPLE))
      out.bad_body = row and not words
    end
  end
  if out.ceiling then text = text .. " ! run time in the current ceiling of an HLS servo" end
  if out.bad_body then text = text .. " ! the body does not fit the command" end
  if dialect == 1 then
    local marker = data:find(TAIL, 5, true)
    if marker and marker < #data - 1 then
      out.marker = marker - 1
      text = text .. " ! 0D 0A inside, a board of the chapter cuts the frame there"
    end
  end
  if out.cooked then text = text .. " ! tail 0A 0A, the port was left with ICRNL" end
  return text
end

-- What is known between packets ------------------------------------------------------------------------------------

local asked_by, matches, answers, streams, fragments, wholes

function proto.init()
  asked_by, matches, answers, streams, fragments, wholes = {}, {}, {}, {}, {}, {}
end

local function line_of(pinfo)
  local one = tostring(pinfo.src) .. ":" .. pinfo.src_port
  local other = tostring(pinfo.dst) .. ":" .. pinfo.dst_port
  return one < other and one .. other or other .. one
end

-- Remembers a request, or finds the one that is answered. Once a frame, when it is first seen.
local function pair(data, key, pinfo, line, from_board)
  if matches[key] ~= nil then return matches[key] or nil end
  matches[key] = false
  local dialect, seq, cmd, ext = data:byte(34), data:byte(35), data:byte(39), data:byte(40)
  if dialect == 2 and bit.band(ext, 64) ~= 0 and ext < 128 then return nil end
  local module = from_board and i32(data, 20) or i32(data, 16)
  local slot = dialect == 1 and line .. " chapter" or line .. " " .. module .. " " .. seq .. " " .. cmd
  if not from_board then
    if dialect == 1 and cmd == 3 then return nil end
    local body = data:sub(HEAD_SIZE + 1, HEAD_SIZE + u16(data, 36))
    if cmd == 26 then body = body:sub(3) end
    asked_by[slot] = {number = pinfo.number, key = key, time = pinfo.abs_ts, packet = body}
    return nil
  end
  local asked = asked_by[slot]
  if asked and pinfo.abs_ts - asked.time > PATIENCE then asked = nil end
  if asked then
    matches[key], asked_by[slot] = asked, nil
    answers[asked.key] = pinfo.number
  end
  return asked
end

-- Puts a chunk to its message. Returns the message's words and length at the chunk that completes it.
local function gather(data, key, pinfo, line)
  if wholes[key] or pinfo.visited then return wholes[key] end
  local body = data:sub(HEAD_SIZE + 1, HEAD_SIZE + u16(data, 36))
  if #body < 8 then return nil end
  local message, index, count = u16(body, 0), u16(body, 2), u16(body, 4)
  local slot = line .. " " .. i32(data, 16) .. " " .. message
  local open = fragments[slot]
  if not open or open.count ~= count then
    open = {count = count, chunks = {}, missing = count}
    fragments[slot] = open
  end
  if not open.chunks[index] and index < count then
    open.chunks[index], open.missing = body:sub(9), open.missing - 1
  end
  if open.missing > 0 or count == 0 then return nil end
  fragments[slot] = nil
  local whole = table.concat(open.chunks, "", 0, count - 1)
  local row = T.commands[body:byte(7)]
  local layout = row and (body:byte(8) >= 128 and row.reply or row.request)
  local words = layout and body_words(whole, layout) or hex(whole, SAMPLE)
  local name = row and row.name or string.format("command 0x%02X", body:byte(7))
  wholes[key] = {text = name .. ": " .. words, size = #whole}
  return wholes[key]
end

-- Trees ----------------------------------------------------------------------------------------------------------

local function servo_tree(tree, range, data, words, is_answer, hazard)
  local branch = tree:add(range, "Servo packet: " .. words)
  branch:add(F.servo_id, range(2, 1))
  branch:add(F.servo_len, range(3, 1))
  branch:add(is_answer and F.error or F.inst, range(4, 1))
  if #data > 6 then branch:add(F.params, range(5, #data - 6)) end
  branch:add(F.checksum, range(#data - 1, 1)):append_text(" (good)")
  branch:add(F.servo_text, range, words):set_generated()
  if hazard then branch:add_proto_expert_info(X.ceiling) end
end

local function frame_tree(range, data, pinfo, tree, key, line, cooked)
  local ext, dialect, cmd = data:byte(40), data:byte(34), data:byte(39)
  local reply = dialect == 2 and ext >= 128
  local from_board = reply or (dialect == 1 and i32(data, 16) == T.board_module)
  local asked = pair(data, key, pinfo, line, from_board)
  local out = {cooked = cooked}
  local text = frame_words(data, asked and asked.packet, out)
  local top = tree:add(proto, range, "hexwire " .. text)
  local header = top:add(range(0, 32), "Session header")
  header:add_le(F.sync, range(0, 4))
  header:add_le(F.time_sec, range(4, 4))
  header:add_le(F.time_nsec, range(8, 4))
  header:add_le(F.sn, range(12, 4))
  header:add_le(F.src, range(16, 4))
  header:add_le(F.dst, range(20, 4))
  header:add_le(F.type, range(24, 4))
  header:add_le(F.size, range(28, 4))
  local len = u16(data, 36)
  local command = top:add(range(32), "Command frame: " .. out.name)
  command:add(F.flag, range(32, 1))
  command:add(F.dialect, range(33, 1))
  command:add(F.seq, range(34, 1))
  command:add(F.pad, range(35, 1))
  command:add_le(F.len, range(36, 2))
  command:add(F.cmd, range(38, 1)):append_text(" (" .. out.name .. ")")
  command:add(F.name, range(38, 1), out.name):set_generated()
  command:add(F.ext, range(39, 1))
  if dialect == 2 then
    command:add(F.reply, range(39, 1))
    command:add(F.report, range(39, 1))
    if reply then
      local item = command:add(F.status, range(39, 1))
      if bit.band(ext, 63) ~= 0 then item:add_proto_expert_info(X.refused) end
    end
  end
  if len > 0 then
    local body = command:add(F.body, range(HEAD_SIZE, len))
    if out.packet then
      local order = cmd == 3 and "little" or cmd == 26 and from_board and "bus" or nil
      local where = from_board and "from_board" or "to_board"
      local words, is_answer, hazard = servo_words(out.packet, asked and asked.packet, where, order)
      servo_tree(command, range(out.packet_at, #out.packet), out.packet, words, is_answer, hazard)
    elseif not out.bad_packet then
      command:add(F.item, range(HEAD_SIZE, len), text:match(": (.*)$") or ""):set_generated()
    end
    if out.bad_packet then body:add_proto_expert_info(X.bad_sum, "Bad servo packet: " .. out.bad_packet) end
    if out.bad_body then body:add_proto_expert_info(X.body) end
    if cmd == 28 and dialect == 2 and not reply and len >= 8 then
      command:add_le(F.message, range(HEAD_SIZE, 2))
      command:add_le(F.index, range(HEAD_SIZE + 2, 2))
      command:add_le(F.chunks, range(HEAD_SIZE + 4, 2))
      local whole = gather(data, key, pinfo, line)
      if whole then
        command:add(F.whole, range(HEAD_SIZE, len), whole.text):set_generated()
        command:add(F.whole_size, range(HEAD_SIZE, len), whole.size):set_generated()
      end
    end
  end
  local verdict = dialect == 2 and "good" or (u16(data, HEAD_SIZE + len) == 0xFFFF and "not checked" or "unknown kind")
  command:add_le(F.check, range(HEAD_SIZE + len, 2)):append_text(" (" .. verdict .. ")")
  local tail = command:add(F.tail, range(#data - 2, 2))
  if cooked then tail:add_proto_expert_info(X.cooked) end
  if out.marker then top:add_proto_expert_info(X.marker) end
  if asked then
    top:add(F.request, asked.number):set_generated()
    top:add(F.took, (pinfo.abs_ts - asked.time)):set_generated()
  end
  if answers[key] then top:add(F.response, answers[key]):set_generated() end
  top:add(F.kind, "frame"):set_generated()
  return text, top
end

local function packet_tree(range, data, pinfo, tree, key, line)
  local slot = line .. " bus"
  if matches[key] == nil then
    local asked = asked_by[slot]
    if asked and pinfo.abs_ts - asked.time > PATIENCE then asked = nil end
    local _, is_answer = servo_words(data, asked and asked.packet, "on_bus")
    matches[key] = is_answer and asked or false
    if not is_answer then
      asked_by[slot] = {number = pinfo.number, key = key, time = pinfo.abs_ts, packet = data}
    elseif asked then
      answers[asked.key] = pinfo.number
      if asked.packet:byte(5) ~= 130 then asked_by[slot] = nil end
    end
  end
  local asked = matches[key] or nil
  local text, is_answer, hazard = servo_words(data, asked and asked.packet, "on_bus")
  if hazard then text = text .. " ! run time in the current ceiling of an HLS servo" end
  local top = tree:add(proto, range, "hexwire " .. text)
  servo_tree(top, range, data, text, is_answer, hazard)
  if asked then
    top:add(F.request, asked.number):set_generated()
    top:add(F.took, (pinfo.abs_ts - asked.time)):set_generated()
  end
  if answers[key] then top:add(F.response, answers[key]):set_generated() end
  top:add(F.kind, "servo packet"):set_generated()
  return text, top
end

-- Shows one cut item. `range` is its bytes.
local function show(item, range, data, pinfo, tree, key, line)
  local text, top
  if item.kind == "frame" or item.kind == "cooked" then
    text, top = frame_tree(range, data, pinfo, tree, key, line, item.kind == "cooked")
  elseif item.kind == "packet" then
    text, top = packet_tree(range, data, pinfo, tree, key, line)
  else
    text = "garbage: " .. #data .. " bytes"
    if item.kind == "bad" then text = "bad frame: " .. item.reason end
    if item.kind == "bad_packet" then text = "bad packet: " .. item.reason end
    top = tree:add(proto, range, "hexwire " .. text)
    local bytes = top:add(F.garbage, range)
    local info = item.kind == "garbage" and X.garbage or item.kind == "bad_packet" and X.bad_sum or X.bad_frame
    if item.kind == "bad" and item.reason:match("^check") then info = X.bad_check end
    bytes:add_proto_expert_info(info, text)
    top:add(F.kind, item.kind == "garbage" and "garbage" or "bad"):set_generated()
  end
  top:add(F.reading, text):set_generated()
  local column = tostring(pinfo.cols.info)
  pinfo.cols.info = pinfo.private.hexwire and column .. " | " .. text or text
  pinfo.private.hexwire = "shown"
end

local function show_all(items, tvb, pinfo, tree, line, base)
  pinfo.cols.protocol = "hexwire"
  for _, item in ipairs(items) do
    local range = tvb(item.from, item.to - item.from)
    show(item, range, range:raw(), pinfo, tree, pinfo.number .. ":" .. (base or "") .. item.from, line)
  end
end

-- Entrances ------------------------------------------------------------------------------------------------------

local function tcp(tvb, pinfo, tree)
  local data = tvb:raw()
  local items, rest, wants = cut_frames(data, false)
  -- One segment may be handed over in parts: the stream position makes the key.
  show_all(items, tvb, pinfo, tree, line_of(pinfo), tvb:len() .. "+")
  if rest < #data then
    pinfo.desegment_offset = rest
    local missing = wants - (#data - rest)
    pinfo.desegment_len = wants > HEAD_SIZE and missing > 0 and missing or DESEGMENT_ONE_MORE_SEGMENT
  end
  return tvb:len()
end

local function udp(tvb, pinfo, tree)
  show_all(cut_frames(tvb:raw(), true), tvb, pinfo, tree, line_of(pinfo))
  return tvb:len()
end

-- A serial line: what one capture packet holds need not be whole.
local function serial(tvb, pinfo, tree)
  local way = pinfo.p2p_dir and tostring(pinfo.p2p_dir) or "?"
  local key = "serial " .. pinfo.number
  if not streams[key] then
    local line = streams[way] or {rest = "", time = 0, frames = false}
    streams[way] = line
    local fresh = tvb:raw()
    local parts = {}
    if line.rest ~= "" and pinfo.abs_ts - line.time > SILENCE then
      parts[1] = {data = line.rest, items = (line.frames and cut_frames or cut_packets)(line.rest, true), old = true}
      line.rest = ""
    end
    local data = line.rest .. fresh
    if not line.frames then
      local bus = data:match("^\255[\255\245]") and not data:find(SYNC, 1, true)
      if proto.prefs.line == "bus" or proto.prefs.line == "host" then bus = proto.prefs.line == "bus" end
      line.frames = not bus
    end
    local items, rest = (line.frames and cut_frames or cut_packets)(data, false)
    parts[#parts + 1] = {data = data, items = items, before = #line.rest}
    line.rest, line.time = data:sub(rest + 1), pinfo.abs_ts
    streams[key] = parts
  end
  pinfo.cols.protocol = "hexwire"
  pinfo.cols.info = tvb:len() .. " bytes, no frame ends here"
  for number, part in ipairs(streams[key]) do
    for _, item in ipairs(part.items) do
      local data = part.data:sub(item.from + 1, item.to)
      local range
      if not part.old and item.from >= part.before then
        range = tvb(item.from - part.before, item.to - item.from)
      else
        range = ByteArray.new(hex(data)):tvb("Reassembled"):range()
      end
      show(item, range, data, pinfo, tree, key .. ":" .. number .. ":" .. item.from, "serial")
    end
  end
  return tvb:len()
end

-- Captures of the wire with no port of ours: the sync word and a header that can be one.
local function looks_right(tvb)
  if tvb:len() < HEAD_SIZE then return false end
  local data = tvb:raw(0, math.min(tvb:len(), T.max_frame))
  return data:sub(1, 4) == SYNC and examine(data, 0) ~= "head"
end

function proto.dissector(tvb, pinfo, tree)
  if pinfo.port_type == 2 then return tcp(tvb, pinfo, tree) end
  if pinfo.port_type == 3 then return udp(tvb, pinfo, tree) end
  return serial(tvb, pinfo, tree)
end

proto:register_heuristic("tcp", function(tvb, pinfo, tree)
  if not looks_right(tvb) then return false end
  pinfo.conversation = proto
  tcp(tvb, pinfo, tree)
  return true
end)
proto:register_heuristic("udp", function(tvb, pinfo, tree)
  if not looks_right(tvb) then return false end
  udp(tvb, pinfo, tree)
  return true
end)

local bound = {tcp = 0, udp = 0}
local function bind()
  for _, way in ipairs({"tcp", "udp"}) do
    local ports, wanted = DissectorTable.get(way .. ".port"), proto.prefs[way .. "_port"]
    if bound[way] ~= wanted then
      if bound[way] > 0 then ports:remove(bound[way], proto) end
      if wanted > 0 then ports:add(wanted, proto) end
      bound[way] = wanted
    end
  end
end
proto.prefs_changed = bind
bind()
DissectorTable.get("wtap_encap"):add(wtap.USER0, proto)
