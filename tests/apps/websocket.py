"""A client of WebSockets (RFC 6455) and of Foxglove's protocol, for tests: it can also send what no client should."""

import base64
import json
import os
import socket
import ssl
import struct
import threading
import time

PROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")


class Refused(Exception):
    pass


class Client:
    def __init__(self, port, protocol=PROTOCOLS[0], path="/", headers=(), context=None, receive_buffer=None):
        self.lock = threading.Lock()
        self.socket = socket.socket()
        if receive_buffer:
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
        self.socket.settimeout(20)
        self.socket.connect(("127.0.0.1", port))
        if context:
            self.socket = context.wrap_socket(self.socket, server_hostname="localhost")
        self.bytes = b""
        self.message = b""
        self.message_op = 0
        self.closed = None  # (code, reason); None: open
        self.channels, self.services, self.subscribed = {}, {}, {}
        self.latest, self.first, self.counts, self.texts, self.answers, self.parameters = {}, {}, {}, [], {}, []
        self.kept = {}  # topic: all of its messages, of topics put in here
        self.info, self.time_ns, self.call_id = None, None, 0
        lines = [f"GET {path} HTTP/1.1", f"Host: 127.0.0.1:{port}", "Upgrade: websocket", "Connection: Upgrade",
                 "Sec-WebSocket-Version: 13", "Sec-WebSocket-Key: " + base64.b64encode(os.urandom(16)).decode()]
        if protocol:
            lines.append(f"Sec-WebSocket-Protocol: {protocol}")
        self.socket.sendall(("\r\n".join([*lines, *headers]) + "\r\n\r\n").encode())
        while b"\r\n\r\n" not in self.bytes:
            more = self._read()
            if not more:
                raise Refused(self.bytes.decode(errors="replace") or "closed")
            self.bytes += more
        head, self.bytes = self.bytes.split(b"\r\n\r\n", 1)
        self.head = head.decode()
        if " 101 " not in self.head.split("\r\n")[0]:
            raise Refused(self.head)

    def _read(self):
        try:
            return self.socket.recv(65536)
        except (ConnectionError, ssl.SSLError):
            return b""

    # ---- out ----

    def frame(self, op, payload, final=True, masked=True):
        if isinstance(payload, str):
            payload = payload.encode()
        size, mask = len(payload), os.urandom(4)
        head = bytes([op | (128 if final else 0)])
        flag = 128 if masked else 0
        head += (bytes([size | flag]) if size < 126 else bytes([126 | flag]) + struct.pack(">H", size) if size < 65536
                 else bytes([127 | flag]) + struct.pack(">Q", size))
        if not masked:
            return head + payload
        key = (mask * (size // 4 + 1))[:size]
        body = (int.from_bytes(payload, "big") ^ int.from_bytes(key, "big")).to_bytes(size, "big") if size else b""
        return head + mask + body

    def send(self, op, payload):
        with self.lock:
            self.socket.sendall(self.frame(op, payload))

    def keep_alive(self):
        """Says each second that it is there, whatever the test waits for."""

        def speak():
            while self.closed is None:
                try:
                    self.send(10, b"!")
                except (OSError, ssl.SSLError):
                    return
                time.sleep(1)

        threading.Thread(target=speak, daemon=True).start()
        return self

    def tell(self, **message):
        self.send(1, json.dumps(message))

    def subscribe(self, *topics):
        """Their numbers begin with 10, so that they are not those of the channels."""
        rows = []
        for topic in topics:
            number = 10 + len(self.subscribed)
            self.subscribed[number] = topic
            rows.append({"id": number, "channelId": self.channels[topic]["id"]})
        self.tell(op="subscribe", subscriptions=rows)

    def order(self, service, call_id=None, **arguments):
        """(True, response) or (False, message)."""
        if call_id is None:
            self.call_id += 1
            call_id = self.call_id
        self.answers.pop(call_id, None)
        number = self.services[service]["id"] if isinstance(service, str) else service
        self.send(2, struct.pack("<BIII", 2, number, call_id, 4) + b"json" + json.dumps(arguments).encode())
        self.until(lambda: call_id in self.answers, 60)
        return self.answers.get(call_id, (None, "no answer"))

    # ---- in ----

    def until(self, condition, seconds=20):
        """Takes messages until it holds; whether it does."""
        end = time.monotonic() + seconds
        while not condition() and self.closed is None and time.monotonic() < end:
            self._frames()
            if condition():
                break
            self.socket.settimeout(max(0.001, min(0.2, end - time.monotonic())))
            try:
                more = self.socket.recv(65536)
            except (socket.timeout, ssl.SSLWantReadError):
                continue
            except (ConnectionError, ssl.SSLError):
                more = b""
            finally:
                self.socket.settimeout(20)
            if not more:
                self.closed = (1006, "")
            self.bytes += more
        self._frames()
        return condition()

    def watch(self, seconds):
        self.until(lambda: False, seconds)

    def _frames(self):
        while len(self.bytes) >= 2:
            size, at = self.bytes[1] & 127, 2
            if size > 125:
                at = 4 if size == 126 else 10
                if len(self.bytes) < at:
                    return
                size = int.from_bytes(self.bytes[2:at], "big")
            if len(self.bytes) < at + size:
                return
            op, final, payload = self.bytes[0] & 15, self.bytes[0] & 128, self.bytes[at:at + size]
            self.bytes = self.bytes[at + size:]
            if op == 8:
                self.closed = (int.from_bytes(payload[:2], "big"), payload[2:].decode(errors="replace"))
            elif op == 9:
                try:
                    self.send(10, payload)
                except (ConnectionError, ssl.SSLError, BlockingIOError):
                    pass
            elif op < 8:
                self.message_op = op or self.message_op
                self.message += payload
                if final:
                    message, self.message = self.message, b""
                    self._take(self.message_op, message)

    def _take(self, op, message):
        if op == 2:
            return self._take_binary(message)
        text = json.loads(message)
        if text["op"] == "advertise":
            self.channels.update({channel["topic"]: channel for channel in text["channels"]})
        elif text["op"] == "advertiseServices":
            self.services.update({service["name"]: service for service in text["services"]})
        elif text["op"] == "serverInfo":
            self.info = text
        elif text["op"] == "serviceCallFailure":
            self.answers[text["callId"]] = (False, text["message"])
        elif text["op"] == "parameterValues":
            self.parameters.append(text)
        else:
            self.texts.append(text)
        return None

    def _take_binary(self, message):
        if message[0] == 1:
            number, time_ns = struct.unpack_from("<IQ", message, 1)
            topic = self.subscribed[number]
            self.counts[topic] = self.counts.get(topic, 0) + 1
            self.latest[topic] = (time_ns, message[13:])
            self.first.setdefault(topic, time_ns)
            if topic in self.kept:
                self.kept[topic].append(self.latest[topic])
        elif message[0] == 2:
            self.time_ns = struct.unpack_from("<Q", message, 1)[0]
        elif message[0] == 3:
            _, call_id, length = struct.unpack_from("<III", message, 1)
            assert message[13:13 + length] == b"json"
            self.answers[call_id] = (True, json.loads(message[13 + length:]))

    def newest(self, topic):
        return json.loads(self.latest[topic][1]) if topic in self.latest else {}

    def phase(self):
        return self.newest("/session").get("phase")

    def ready(self):
        """Connected, and told what there is."""
        self.until(lambda: self.info and self.channels and self.services)
        return self

    def close(self):
        self.socket.close()
        self.closed = self.closed or (1000, "")
