// The Foxglove WebSocket protocol (https://github.com/foxglove/ws-protocol), the client's side, as functions of bytes.

export const SUBPROTOCOLS = ['foxglove.sdk.v1', 'foxglove.websocket.v1'];

export interface Channel {
  id: number;
  topic: string;
  encoding: string;
  schemaName: string;
}

export interface Service {
  id: number;
  name: string;
}

export interface ParameterValue {
  name: string;
  value: number | string | boolean | null;
}

export type TextMessage =
  | { op: 'serverInfo'; name: string; sessionId?: string; metadata?: Record<string, string> }
  | { op: 'advertise'; channels: Channel[] }
  | { op: 'unadvertise'; channelIds: number[] }
  | { op: 'advertiseServices'; services: Service[] }
  | { op: 'serviceCallFailure'; serviceId: number; callId: number; message: string }
  | { op: 'parameterValues'; parameters: ParameterValue[]; id?: string }
  | { op: 'status'; level: number; message: string };

export type BinaryMessage =
  | { op: 'data'; subscription: number; time_ns: bigint; bytes: Uint8Array }
  | { op: 'time'; time_ns: bigint }
  | { op: 'response'; call: number; bytes: Uint8Array }
  | { op: 'other' };

export function decodeBinary(buffer: ArrayBuffer): BinaryMessage {
  const view = new DataView(buffer);
  const op = buffer.byteLength > 0 ? view.getUint8(0) : 0;
  if (op === 1 && buffer.byteLength >= 13)
    return {
      op: 'data',
      subscription: view.getUint32(1, true),
      time_ns: view.getBigUint64(5, true),
      bytes: new Uint8Array(buffer, 13),
    };
  if (op === 2 && buffer.byteLength >= 9) return { op: 'time', time_ns: view.getBigUint64(1, true) };
  if (op === 3 && buffer.byteLength >= 13)
    return {
      op: 'response',
      call: view.getUint32(5, true),
      bytes: new Uint8Array(buffer, 13 + view.getUint32(9, true)),
    };
  return { op: 'other' };
}

export function encodeCall(service: number, call: number, request: unknown): ArrayBuffer {
  const encoding = new TextEncoder().encode('json');
  const body = new TextEncoder().encode(JSON.stringify(request));
  const bytes = new Uint8Array(13 + encoding.length + body.length);
  const view = new DataView(bytes.buffer);
  view.setUint8(0, 2);
  view.setUint32(1, service, true);
  view.setUint32(5, call, true);
  view.setUint32(9, encoding.length, true);
  bytes.set(encoding, 13);
  bytes.set(body, 13 + encoding.length);
  return bytes.buffer;
}
