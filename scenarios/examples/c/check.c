/* Reads lines "WIDTH HEX", a datagram each, and prints what `decode` says: the reason, or the packet encoded again.
   So an implementation is held against teleop/protocol/vectors.json, and against bytes that nobody meant. */
#include "wire.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static int digit(int c) { return c >= '0' && c <= '9' ? c - '0' : c >= 'a' && c <= 'f' ? c - 'a' + 10 : -1; }

int main(void) {
    static char line[4 * MOST_CONTROL];
    static uint8_t out[MOST_CONTROL];
    static Packet packet;
    while (fgets(line, sizeof line, stdin)) {
        char *hex = strchr(line, ' ');
        if (!hex) return 2;
        size_t size = strspn(++hex, "0123456789abcdef") / 2;
        uint8_t *data = malloc(size ? size : 1); /* exactly as long, so that a read beyond it is seen */
        if (!data) return 1;
        for (size_t i = 0; i < size; i++) data[i] = (uint8_t)(digit(hex[2 * i]) << 4 | digit(hex[2 * i + 1]));
        const char *why = decode(data, size, atoi(line), &packet);
        if (why) puts(why);
        else {
            size_t made = encode(&packet, size, out);
            for (size_t i = 0; i < made; i++) printf("%02x", out[i]);
            puts("");
            if (packet.kind == HELLO || packet.kind == WELCOME) {
                int64_t value;
                if (!same_entries(packet.text, packet.text)) return 3;
                (void)told(packet.text, "@tick 0", &value);
            }
        }
        free(data);
    }
    return 0;
}
