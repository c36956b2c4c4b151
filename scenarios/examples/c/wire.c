/* The packets of wire version 4, to bytes and back: see wire.h. Nothing here is kept, and nothing is allocated. */
#include "wire.h"

#include <math.h>
#include <string.h>

typedef struct { const uint8_t *at, *end; int bad; } In;
typedef struct { uint8_t *at, *end; int full; } Out;

static uint32_t crc32(const uint8_t *data, size_t size) {
    uint32_t crc = 0xFFFFFFFFu;
    for (size_t i = 0; i < size; i++) {
        crc ^= data[i];
        for (int bit = 0; bit < 8; bit++) crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u)));
    }
    return ~crc;
}

static uint64_t big(In *in, int bytes) { /* a number of so many bytes, the big end first */
    uint64_t value = 0;
    if (in->end - in->at < bytes) { in->bad = 1; in->at = in->end; return 0; }
    while (bytes--) value = value << 8 | *in->at++;
    return value;
}

static int nil(In *in) { return in->at < in->end && *in->at == 0xC0 ? (in->at++, 1) : 0; }

static uint64_t whole(In *in, int *negative) { /* an integer in any of msgpack's forms, as 64 bits */
    uint64_t tag = big(in, 1), value = tag;
    if (tag < 0x80) value = tag;
    else if (tag >= 0xE0) value = tag | ~(uint64_t)0xFF;
    else if (tag >= 0xCC && tag <= 0xCF) value = big(in, 1 << (tag - 0xCC));
    else if (tag >= 0xD0 && tag <= 0xD3) {
        int bytes = 1 << (tag - 0xD0);
        value = big(in, bytes);
        if (bytes < 8 && value >> (8 * bytes - 1)) value |= ~(uint64_t)0 << (8 * bytes);
    } else in->bad = 1;
    *negative = (tag >= 0xE0 || (tag >= 0xD0 && tag <= 0xD3)) && value >> 63;
    return value;
}

static uint64_t count(In *in) { /* an integer that is not negative */
    int negative;
    uint64_t value = whole(in, &negative);
    if (negative) in->bad = 1;
    return value;
}

static int64_t ns(In *in) { /* an integer of 64 bits with a sign */
    int negative;
    uint64_t value = whole(in, &negative);
    if (!negative && value >> 63) { in->bad = 1; return 0; }
    return negative ? -(int64_t)~value - 1 : (int64_t)value;
}

static double real(In *in) {
    uint64_t tag = big(in, 1), bits;
    double value;
    if (tag == 0xCA) {
        uint32_t half = (uint32_t)big(in, 4);
        float single;
        memcpy(&single, &half, 4);
        return (double)single;
    }
    if (tag != 0xCB) in->bad = 1;
    bits = big(in, 8);
    memcpy(&value, &bits, 8);
    return value;
}

static size_t length(In *in, unsigned fix, unsigned mask, unsigned tag8, unsigned tag16) {
    unsigned tag = (unsigned)big(in, 1);
    if ((tag & ~mask) == fix) return tag & mask;
    if (tag8 && tag == tag8) return (size_t)big(in, 1);
    if (tag == tag16) return (size_t)big(in, 2);
    if (tag == tag16 + 1) return (size_t)big(in, 4);
    in->bad = 1;
    return 0;
}

static size_t array(In *in) { return length(in, 0x90, 0x0F, 0, 0xDC); }
static size_t map(In *in) { return length(in, 0x80, 0x0F, 0, 0xDE); }

static Text text(In *in) { /* the well-formed are UTF-8 without control characters; who shows one checks the rest */
    Text found = {in->at, length(in, 0xA0, 0x1F, 0xD9, 0xDA)};
    found.at = in->at;
    if (in->bad || found.size > (size_t)(in->end - in->at)) { in->bad = 1; found.size = 0; return found; }
    in->at += found.size;
    for (size_t i = 0; i < found.size; i++) {
        unsigned c = found.at[i], more = c < 0x80 ? 0 : c >= 0xC2 && c < 0xE0 ? 1 : (c & 0xF0) == 0xE0 ? 2 : 3;
        if (c < 0x20 || c == 0x7F || (c >= 0x80 && c < 0xC2) || c > 0xF4 || more > found.size - i - 1) in->bad = 1;
        else if (more) {
            unsigned next = found.at[i + 1];
            if ((c == 0xE0 && next < 0xA0) || (c == 0xED && next > 0x9F) || (c == 0xF0 && next < 0x90) ||
                (c == 0xF4 && next > 0x8F) || (c == 0xC2 && next < 0xA1)) in->bad = 1;
            while (more--) if ((found.at[++i] & 0xC0) != 0x80) { in->bad = 1; break; }
        }
        if (in->bad) return found;
    }
    return found;
}

const char *decode(const uint8_t *data, size_t size, int width, Packet *out) {
    In in = {data + 4, data + size, 0};
    size_t body, fields;
    memset(out, 0, sizeof *out);
    if (size > MOST_CONTROL) return "oversize";
    if (size < 10) return "truncated";
    if (data[0] != 'B' || data[1] != 'T') return "magic";
    if (data[2] != 4) return "version";
    out->kind = data[3];
    if (out->kind <= BACK && size > MOST_DATA) return "oversize";
    body = (size_t)big(&in, 2);
    if (body + 10 > size) return "truncated";
    in.at = data + size - 4;
    if (crc32(data, size - 4) != (uint32_t)big(&in, 4)) return "checksum";
    if (out->kind > RENEW) return "malformed";
    for (size_t i = 6 + body; i < size - 4; i++) if (data[i]) return "malformed";
    in.at = data + 6;
    in.end = data + 6 + body;
    if (array(&in) != 6) return "malformed";
    out->session = count(&in);
    fields = (size_t)count(&in);
    if (fields > 0xFFFFFFFFu) return "malformed";
    out->seq = (uint32_t)fields;
    out->sent_ns = ns(&in);
    out->echoes = !nil(&in);
    if (out->echoes) {
        if (array(&in) != 2) return "malformed";
        out->echo_sent_ns = ns(&in);
        out->echo_held_ns = ns(&in);
        if (out->echo_held_ns < 0) return "malformed";
    }
    if (out->kind <= BACK) {
        fields = array(&in);
        if (fields != (size_t)width || width > MOST_NUMBERS) return "malformed";
        for (out->width = 0; out->width < width; out->width++) out->number[out->width] = real(&in);
    } else if (out->kind == START) out->tick_0_ns = ns(&in);
    else if (out->kind == HELLO || out->kind == WELCOME) {
        out->text.at = in.at;
        fields = map(&in);
        if (fields > MOST_ENTRIES) return "malformed";
        for (size_t i = 0; i < 2 * fields && !in.bad; i++) (void)text(&in);
        out->text.size = (size_t)(in.at - out->text.at);
    } else {
        size_t letters = 0;
        out->text = text(&in);
        for (size_t i = 0; i < out->text.size; i++) letters += (out->text.at[i] & 0xC0) != 0x80;
        if (letters > MOST_SENTENCE) return "malformed";
    }
    out->stamped = !nil(&in);
    if (out->stamped) out->E_in = real(&in);
    if (in.bad || in.at != in.end) return "malformed";
    for (int i = 0; i < out->width; i++) if (!isfinite(out->number[i])) return "non-finite";
    return isfinite(out->E_in) ? NULL : "non-finite";
}

static void put(Out *out, uint64_t value, int bytes) {
    if (out->end - out->at < bytes) { out->full = 1; return; }
    while (bytes--) *out->at++ = (uint8_t)(value >> (8 * bytes));
}

static void put_bytes(Out *out, const uint8_t *data, size_t size) {
    if ((size_t)(out->end - out->at) < size) { out->full = 1; return; }
    if (size) memcpy(out->at, data, size);
    out->at += size;
}

static void put_count(Out *out, uint64_t value) { /* in the shortest form: a filter may look for it so */
    if (value < 0x80) put(out, value, 1);
    else for (int i = 0; i < 4; i++) if (i == 3 || value >> (8 << i) == 0) {
        put(out, 0xCC + (uint64_t)i, 1);
        put(out, value, 1 << i);
        return;
    }
}

static void put_ns(Out *out, int64_t value) {
    if (value >= 0) { put_count(out, (uint64_t)value); return; }
    if (value >= -32) { put(out, (uint8_t)value, 1); return; }
    for (int i = 0; i < 4; i++) if (i == 3 || value >= -((int64_t)1 << ((8 << i) - 1))) {
        put(out, 0xD0 + (uint64_t)i, 1);
        put(out, (uint64_t)value, 1 << i);
        return;
    }
}

static void put_real(Out *out, double value) {
    uint64_t bits;
    memcpy(&bits, &value, 8);
    put(out, 0xCB, 1);
    put(out, bits, 8);
}

size_t encode(const Packet *packet, size_t least, uint8_t *data) {
    Out out = {data, data + MOST_CONTROL - 4, 0};
    put(&out, 0x42540400u + (uint64_t)packet->kind, 4);
    put(&out, 0, 2);
    put(&out, 0x96, 1);
    put_count(&out, packet->session);
    put_count(&out, packet->seq);
    put_ns(&out, packet->sent_ns);
    if (packet->echoes) {
        put(&out, 0x92, 1);
        put_ns(&out, packet->echo_sent_ns);
        put_ns(&out, packet->echo_held_ns);
    } else put(&out, 0xC0, 1);
    if (packet->kind <= BACK) {
        if (packet->width < 16) put(&out, 0x90u + (uint64_t)packet->width, 1);
        else { put(&out, 0xDC, 1); put(&out, (uint64_t)packet->width, 2); }
        for (int i = 0; i < packet->width; i++) put_real(&out, packet->number[i]);
    } else if (packet->kind == START) put_ns(&out, packet->tick_0_ns);
    else {
        if (packet->kind != HELLO && packet->kind != WELCOME) {
            size_t size = packet->text.size;
            if (size < 32) put(&out, 0xA0 + size, 1);
            else if (size < 256) { put(&out, 0xD9, 1); put(&out, size, 1); }
            else { put(&out, 0xDA, 1); put(&out, size, 2); }
        }
        put_bytes(&out, packet->text.at, packet->text.size);
    }
    if (packet->stamped) put_real(&out, packet->E_in); else put(&out, 0xC0, 1);
    size_t body = (size_t)(out.at - data) - 6;
    data[4] = (uint8_t)(body >> 8);
    data[5] = (uint8_t)body;
    while (!out.full && (size_t)(out.at - data) + 4 < least) put(&out, 0, 1);
    if (out.full) return 0;
    out.end += 4;
    put(&out, crc32(data, (size_t)(out.at - data)), 4);
    return (size_t)(out.at - data);
}

static int entry(Text whole_map, const uint8_t *name, size_t size, Text *value) { /* the last such counts */
    In in = {whole_map.at, whole_map.at + whole_map.size, 0};
    int found = 0;
    for (size_t n = map(&in); n && !in.bad; n--) {
        Text key = text(&in), its = text(&in);
        if (key.size == size && !memcmp(key.at, name, size)) { *value = its; found = 1; }
    }
    return found;
}

static int all_in(Text one, Text other) {
    In in = {one.at, one.at + one.size, 0};
    for (size_t n = map(&in); n; n--) {
        Text key = text(&in), value = text(&in), its;
        if (in.bad) return 0;
        if (key.size && key.at[0] == '@') continue;
        if (!entry(other, key.at, key.size, &its) || its.size != value.size || memcmp(its.at, value.at, its.size))
            return 0;
    }
    return !in.bad;
}

int same_entries(Text one, Text other) { return all_in(one, other) && all_in(other, one); }

int has_entry(Text whole_map, const char *name, const char *value) {
    Text its;
    return entry(whole_map, (const uint8_t *)name, strlen(name), &its) && its.size == strlen(value) &&
           !memcmp(its.at, value, its.size);
}

int told(Text whole_map, const char *name, int64_t *out) {
    Text its;
    if (!entry(whole_map, (const uint8_t *)name, strlen(name), &its)) return 0;
    size_t i = its.size && its.at[0] == '-';
    if (its.size <= i || its.size >= 20) return 0;
    uint64_t value = 0;
    for (size_t n = i; n < its.size; n++) {
        if (its.at[n] < '0' || its.at[n] > '9') return 0;
        value = 10 * value + (uint64_t)(its.at[n] - '0');
    }
    if (value >> 61) return 0;
    *out = i ? -(int64_t)value : (int64_t)value;
    return 1;
}
