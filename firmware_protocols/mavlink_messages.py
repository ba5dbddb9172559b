"""The messages of MAVLink: how long each is, what checks it, and what those used here hold.

Generated from the definitions of the dialect "all" that pymavlink 2.4.50 carries (common, ArduPilot
and others; their numbers do not clash); the tests hold every entry against the installed one.

The fields of a payload are on the wire in order of falling size, then those of the extension.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

_CHECKS = """
0:50:9 1:124:31+12 2:137:12 4:237:14 5:217:28 6:104:3 7:119:32 11:89:6 20:214:20 21:159:2
22:220:25 23:168:23 24:24:30+22 25:23:101 26:170:22+2 27:144:26+3 28:67:16 29:115:14+2 30:39:28
31:246:32+16 32:185:28 33:104:28 34:237:22 35:244:22 36:222:21+16 37:212:6+1 38:9:6+1
39:254:37+1 40:230:4+1 41:28:4 42:28:2+4 43:132:2+1 44:221:4+1 45:232:2+1 46:11:2 47:153:3+1
48:41:13+8 49:39:12+8 50:78:37 51:196:4+1 53:3:5 54:15:27 55:3:25 61:167:72 62:183:26 63:119:181
64:191:225 65:118:42 66:148:6 67:21:4 69:243:11+19 70:124:18+20 73:38:37+1 74:20:20 75:158:35
76:152:33 77:143:3+7 81:106:22 82:49:39 83:22:37 84:143:53 85:140:51 86:5:53 87:150:51 89:231:28
90:183:56 91:63:42 92:54:33 93:47:81 100:175:26+8 101:102:32+85 102:158:32+85 103:208:20+37
104:56:32+84 105:93:62+1 106:138:44 107:108:64+1 108:32:84+8 109:185:9 110:84:254 111:34:16
112:174:12 113:124:36+3 114:237:44 115:4:64 116:76:22+2 117:128:6 118:56:14 119:116:12
120:134:97 121:237:2 122:203:2 123:250:113 124:87:35+22 125:203:6 126:220:79 127:25:35
128:226:35 129:46:22+2 130:29:13 131:223:255 132:85:14+25 133:6:18 134:229:43 135:203:8 136:1:22
137:195:14+2 138:109:36+84 139:168:43 140:181:41 141:47:32 142:72:243 143:131:14+2 144:127:93
146:103:100 147:154:36+18 148:178:60+18 149:200:30+30 150:134:42 151:219:8 152:208:4+4
153:188:12 154:84:15 155:22:13 156:19:6 157:21:15 158:134:14+1 160:78:12 161:68:3 162:189:8+1
163:127:28 164:154:44 165:21:3 166:21:9 167:144:22 168:1:12 169:234:18 170:73:34 171:181:66
172:22:98 173:83:8 174:167:48 175:138:19 176:234:3 177:240:20 178:47:24 179:189:29 180:52:45+2
181:174:4 182:229:40 183:85:2 184:159:206 185:186:7 186:72:29 191:92:27 192:36:44+10 193:71:22+4
194:98:25+8 195:120:37 200:134:42 201:205:14 214:69:8 215:101:3 216:50:3 217:202:6 218:17:7
219:162:2 220:34:32 221:71:42 222:15:3 223:119:47 224:102:45 225:208:65+8 226:207:8 230:163:42
231:105:40 232:151:63+2 233:35:182 234:150:40 235:179:42 241:90:32 242:104:52+8 243:85:53+8
244:95:6 245:130:2 246:184:38 247:81:19 248:8:254 249:204:36 250:49:30 251:170:18 252:44:18
253:83:51+3 254:46:9 256:71 257:131 258:187 259:92 260:146 261:179 262:12 263:133 264:49 265:26
266:193 267:35 268:14 269:109 270:59 271:22 275:126 276:18 277:62 280:70 281:48 282:123 283:74
284:99 285:137 286:210 287:1 288:20 295:234 296:158 299:19 301:243 310:28 311:95 320:243 321:88
322:243 323:78 324:132 330:23 331:91 332:236 333:231 335:225 339:199 340:99 345:209 350:232
360:11 370:75 373:117 375:251 376:199 385:147 386:132 387:4 388:8 390:156 420:20 435:134 436:193
437:30 441:169 513:99 8002:218 8003:231 8004:172 8005:251 8006:97 8007:64 8008:234 8009:144
8010:155 8011:20 8012:54 8013:222 8014:200 8015:23 8016:149 9000:113 9005:117 10001:209
10002:186 10003:4 10004:133 10005:103 10006:193 10007:71 10008:240 10151:195 11000:134 11001:15
11002:234 11003:64 11004:11 11005:93 11010:46 11011:106 11020:205 11030:144 11031:133 11032:85
11033:195 11034:79 11035:128 11036:177 11037:130 11038:47 11039:142 11040:132 11041:208
11042:201 11043:193 11044:189 11060:162 12900:114 12901:254 12902:140 12903:249 12904:77
12905:49 12915:94 12918:139 12919:7 12920:20 17000:103 17150:26 17151:72 17153:19 17154:89
17155:27 17156:14 17157:187 17158:106 42000:227 42001:239 50001:246 50002:181 50003:62 50004:240
50005:152 52000:13 52001:239 60000:4 60010:208 60011:183 60012:99 60013:129 60014:134 60020:202
60040:156 60041:191 60045:14 60046:171 60047:55 60050:220 60051:245 60052:101 60053:45
"""
"""For every message its number, its CRC_EXTRA and, where MAVLink 1 has it, the bytes of its payload
there + those that the extension adds."""


@dataclass(frozen=True)
class Check:
    """What must be known of a message to check its frame.

    Attributes
    ----------
    crc_extra : int
        Byte that ends what the checksum covers: a digest of the message's definition.
    base, extended : int
        Bytes of the payload without and with the extension; 0 for a message of MAVLink 2 alone.
    """

    crc_extra: int
    base: int = 0
    extended: int = 0


def _checks() -> dict[int, Check]:
    checks = {}
    for entry in _CHECKS.split():
        number, crc_extra, *sizes = entry.split(":")
        base, _, extension = sizes[0].partition("+") if sizes else ("0", "", "")
        checks[int(number)] = Check(int(crc_extra), int(base), int(base) + int(extension or 0))
    return checks


CHECKS: dict[int, Check] = _checks()
"""Every message known, by its number."""


@dataclass(frozen=True)
class Message:
    """A message whose content is read here.

    Attributes
    ----------
    name : str
    number : int
    fields : str
        Name and type of each field in the order of the wire, as "time_usec:u8 acc:3f4", the
        extension included; a number before the type is how many there are of it, "s" is text.
    """

    name: str
    number: int
    fields: str

    @cached_property
    def dtype(self) -> np.dtype[np.void]:
        """The payload as a structured type without gaps."""
        members = []
        for entry in self.fields.split():
            name, kind = entry.split(":")
            members.append((name, _wire_type(kind)))
        return np.dtype(members)

    @property
    def check(self) -> Check:
        """What checks it."""
        return CHECKS[self.number]


def _wire_type(kind: str) -> str:
    """Return numpy's name of a type: "3f4" becomes "(3,)<f4", "16s" becomes "S16"."""
    if kind.endswith("s"):
        return f"S{kind[:-1]}"
    count, code = kind[:-2], kind[-2:]
    return f"({count},)<{code}" if count else f"<{code}"


_TRIADS = "acc:3i2 gyro:3i2 mag:3i2"

HEARTBEAT = Message(
    "HEARTBEAT",
    0,
    "custom_mode:u4 type:u1 autopilot:u1 base_mode:u1 system_status:u1 mavlink_version:u1",
)
PARAM_VALUE = Message(
    "PARAM_VALUE",
    22,
    "param_value:f4 param_count:u2 param_index:u2 param_id:16s param_type:u1",
)
SCALED_IMU = Message("SCALED_IMU", 26, f"time_boot_ms:u4 {_TRIADS} temperature:i2")
RAW_IMU = Message("RAW_IMU", 27, f"time_usec:u8 {_TRIADS} id:u1 temperature:i2")
SCALED_PRESSURE = Message(
    "SCALED_PRESSURE",
    29,
    "time_boot_ms:u4 press_abs:f4 press_diff:f4 temperature:i2 temperature_press_diff:i2",
)
PARAM_REQUEST_READ = Message(
    "PARAM_REQUEST_READ", 20, "param_index:i2 target_system:u1 target_component:u1 param_id:16s"
)
REQUEST_DATA_STREAM = Message(
    "REQUEST_DATA_STREAM",
    66,
    "req_message_rate:u2 target_system:u1 target_component:u1 req_stream_id:u1 start_stop:u1",
)
COMMAND_LONG = Message(
    "COMMAND_LONG",
    76,
    "param:7f4 command:u2 target_system:u1 target_component:u1 confirmation:u1",
)
COMMAND_ACK = Message(
    "COMMAND_ACK",
    77,
    "command:u2 result:u1 progress:u1 result_param2:i4 target_system:u1 target_component:u1",
)
HIGHRES_IMU = Message(
    "HIGHRES_IMU",
    105,
    "time_usec:u8 acc:3f4 gyro:3f4 mag:3f4 abs_pressure:f4 diff_pressure:f4 pressure_alt:f4 "
    "temperature:f4 fields_updated:u2 id:u1",
)
SCALED_IMU2 = Message("SCALED_IMU2", 116, SCALED_IMU.fields)
SCALED_IMU3 = Message("SCALED_IMU3", 129, SCALED_IMU.fields)
AUTOPILOT_VERSION = Message(
    "AUTOPILOT_VERSION",
    148,
    "capabilities:u8 uid:u8 flight_sw_version:u4 middleware_sw_version:u4 os_sw_version:u4 "
    "board_version:u4 vendor_id:u2 product_id:u2 flight_custom_version:8u1 "
    "middleware_custom_version:8u1 os_custom_version:8u1 uid2:18u1",
)
MESSAGES: dict[str, Message] = {
    message.name: message
    for message in (
        HEARTBEAT,
        PARAM_REQUEST_READ,
        PARAM_VALUE,
        SCALED_IMU,
        RAW_IMU,
        SCALED_PRESSURE,
        REQUEST_DATA_STREAM,
        COMMAND_LONG,
        COMMAND_ACK,
        HIGHRES_IMU,
        SCALED_IMU2,
        SCALED_IMU3,
        AUTOPILOT_VERSION,
    )
}
"""Every message that is read here, by its name."""
