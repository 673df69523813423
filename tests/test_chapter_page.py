"""docs/chapter.md names everything of the chapter, and what it points to exists."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import pytest

from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import Instruction
from hexwire.wire.tables import BROADCAST_ID

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "chapter.md"
TEXT = PAGE.read_text(encoding="utf-8")

# Plain names, by section of the chapter.
NAMES = {
    "9.1": """
        Hex7bot Arduino Mega2560 Raspberry ttyUSB0 chmod HLS3606M URT-1 RS-485 S8050 Appendix
        """,
    "9.2": """
        hardware_interface hardware_interface_node jntCmdChan hex7bot_sess_ hex7bot_robot_ hex7bot_driver_
        HEX7BOT_RBT Ipchandle Session Hex7BotDriver robot_driver RobotDriver signal probe attach detach read write
        ioctl sig_id sub_cmd dataBuf bufSize sessIO m_sess m_rbtState RCCL SESSION_HEADER_t SESSION_HEADER sync
        time_sec time_nsec sn src dst type size messageType_e hex7bot_conf_file ROS_INFO ipchdl Ipctype_e
        IPC_QUEUE IPC_TCP_SOCKET IPC_UDP_SOCKET IPC_SERIAL_PORT TOTAL_IPC_TYPES ModuleType_e ModuleType ROS1_HOST
        JOY_STICK PUMA260_HOST_IO_TRX PUMA260_RBT_IO_SVR PUMA260_HOST_JNT_CMD_TX PUMA260_HOST_JSTATE_RX
        PUMA260_HOST_JTRAJ_TX ARM_7BOT_SERIAL_TRX ARM_7BOT_ARDUINO_TRX LastModuleTypes INVALID_MODULE ModuleList_t
        MODULE_TYPE_STR ipc_msg conf module_name direction destination interface device port CLIENT_TRX TCP UDP
        ipc_common PUMA260 JointCommands
        """,
    "9.3": """
        APP_CMD_HEADER_tag APP_CMD_HEADER u8Flag u8Proto u8Seq u8Pad u16Len u8Cmd u8CmdExt SerialPort Length
        FPGA SoPC 0x5AFAFA5A 0x82 0D 0A HW Hex7botRos BF
        """,
    "9.4": """
        sketch ATmega256 IDE setup loop Arm MyArm begin USB_SER Serial Serial1 setTimeout position_init delay
        serFrmStartDword serFrmFooterWord serRxBuf serTxBuf syncFound footerFound txFrmHead rxFrmHead sentBytes
        readByte lastByte readDWord sn timeout lastTime receivedFrame transmitFrame decode hostSend arm_sync_write
        servo_read servo_ping sendServoDataToHost respBuf command cmd_length availableWrittenBytes
        availableForWrite currSend currSentBytes sync_total_len regAddr one_dataalen position runtime joint_move
        Steer_Num steer littleEndian readbuf readSer1Byte cnt retry1 retry2 maxTries dataBuf datalen u8pad time_s
        time_ns millis ARM Steer_Protocol 7-bot BROADCAST_ADDR INSTRUCTION_PING INSTRUCTION_READ_DATA
        INSTRUCTION_WRITE_DATA INSTRUCTION_REG_WRITE INSTRUCTION_ACTION INSTRUCTION_RESET INSTRUCTION_SYNC_WRITE
        ID_REG MIN_ANGLE_LIMIT_H MIN_ANGLE_LIMIT_L MAX_ANGLE_LIMIT_H MAX_ANGLE_LIMIT_L MAX_TORQUE_H MAX_TORQUE_L
        DEFAULT_SPEED MIDDLE_POSITION_H MIDDLE_POSITION_L TORQUE_SWITCH TARGET_POSITION_H TARGET_POSITION_L
        CURRENT_POSITION_H CURRENT_POSITION_L TARGET_SPEED REG_WRITE SYNC_WRITE JTAG Saleae SCServo Debug
        """,
}
FIGURES = [f"Figure 9.{n}" for n in range(1, 11)]
SECTIONS = ["9.1", "9.2", "9.3", "9.4", "9.4.1", "9.4.2", "9.4.3", "9.5"]
MACROS = {
    "ID_REG": 0x05,
    "MIN_ANGLE_LIMIT_H": 0x09,
    "MAX_ANGLE_LIMIT_H": 0x0B,
    "MAX_TORQUE_H": 0x10,
    "DEFAULT_SPEED": 0x12,
    "MIDDLE_POSITION_H": 0x14,
    "TORQUE_SWITCH": 0x28,
    "TARGET_POSITION_H": 0x2A,
    "CURRENT_POSITION_H": 0x38,
    "TARGET_SPEED": 0x41,
}
INSTRUCTIONS = {
    "INSTRUCTION_PING": 0x01,
    "INSTRUCTION_READ_DATA": 0x02,
    "INSTRUCTION_WRITE_DATA": 0x03,
    "INSTRUCTION_REG_WRITE": 0x04,
    "INSTRUCTION_ACTION": 0x05,
    "INSTRUCTION_SYNC_WRITE": 0x83,
}
LINK = re.compile(r"\[([^\]]*)\]\(([^)#]*)(#[^)]*)?\)")
WORD = re.compile(r"[A-Za-z_]\w+")
NOT_IN_FILES = {"hexwire", "json"}


def rows(section: str) -> list[list[str]]:
    """The cells of all table rows of a section of the page and what is below it."""
    part = re.split(rf"^## {re.escape(section)} ", TEXT, flags=re.MULTILINE)[1]
    part = re.split(r"^## ", part, maxsplit=1, flags=re.MULTILINE)[0]
    lines = [line for line in part.splitlines() if line.startswith("| ") and "---" not in line]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


ROWS = [row for section in ("9.1", "9.2", "9.3", "9.4") for row in rows(section) if row[0] != "in the chapter"]


@cache
def words_of(path: Path) -> frozenset[str]:
    return frozenset(re.findall(r"\w+", path.read_text(encoding="utf-8")))


def slugs(path: Path) -> set[str]:
    """Anchors of a page's headings, as GitHub makes them."""
    heads = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


@pytest.mark.parametrize("section", NAMES)
def test_every_name_of_the_chapter_is_in_the_table_of_its_section(section: str) -> None:
    there = {word for row in rows(section) for word in re.findall(r"[\w-]+", row[0])}
    there |= {word.strip("-") for word in there} | {word.lower() for word in there if word == "Hex7Bot"}
    wanted = [name for name in NAMES[section].split() if name != "Hex7bot"]
    assert [name for name in wanted if name not in there] == []


def test_every_figure_and_section_has_its_place() -> None:
    first = " ".join(row[0] for row in ROWS)
    assert [figure for figure in FIGURES if not re.search(rf"{re.escape(figure)}\b(?!\d)", first)] == []
    heads = re.findall(r"^##+ (9[\d.]*) ", TEXT, re.MULTILINE)
    assert heads == SECTIONS


def test_every_row_says_where() -> None:
    assert len(ROWS) > 90
    for row in ROWS:
        assert len(row) == 3, row
        assert LINK.search(row[1]) or (row[1] == "–" and row[2]), row
        # Outside of links nobody would check a name.
        assert "`" not in LINK.sub("", row[1]), row


def test_what_the_page_points_to_exists() -> None:
    gone = []
    for text, target, anchor in LINK.findall(TEXT):
        path = (PAGE.parent / target).resolve() if target else PAGE
        if not path.is_file():
            gone.append(target)
        elif anchor and anchor[1:] not in slugs(path):
            gone.append(target + anchor)
        elif path.suffix != ".md":
            spans = re.findall(r"`([^`]*)`", text)
            names = {name for span in spans for name in WORD.findall(span)} - NOT_IN_FILES
            gone += [f"{name} in {target}" for name in sorted(names - words_of(path) - {path.stem})]
    assert gone == []


def test_the_macros_are_the_registers_that_the_page_names() -> None:
    for macro, address in MACROS.items():
        (row,) = [row for row in ROWS if f"`{macro}`" in row[0]]
        register = Series.SEVEN_BOT.at(address)
        assert register is not None
        assert f"`{register.name}`" in row[1], macro
        assert register.size == (2 if macro.endswith("_H") else 1), macro
    (row,) = [row for row in ROWS if "`INSTRUCTION_PING`" in row[0]]
    theirs, ours = (re.findall(r"`(\w+)`", cell) for cell in row[:2])
    assert {theirs[i]: Instruction[name] for i, name in enumerate(ours)} == INSTRUCTIONS
    assert (Instruction.RESTORE, BROADCAST_ID) == (0x06, 0xFE)
