/* The packets of wire version 4, to bytes and back: teleop/protocol/WIRE.md says what each field is. */
#ifndef WIRE_H
#define WIRE_H
#include <stddef.h>
#include <stdint.h>

enum { FORTH, BACK, HELLO, WELCOME, REFUSE, START, BYE, RENEW };
enum { NO_CODE, CLUTCH, TURN, FINISHED }; /* of the reason in a RENEW or BYE, which stands in `seq` */
enum { MOST_DATA = 1200, MOST_CONTROL = 8192, MOST_NUMBERS = 133, MOST_ENTRIES = 512, MOST_SENTENCE = 1000 };
typedef struct { const uint8_t *at; size_t size; } Text; /* points into the datagram; not ended by a zero */

typedef struct {
    int kind;
    uint64_t session;
    uint32_t seq;
    int64_t sent_ns;
    int echoes; /* is there an echo */
    int64_t echo_sent_ns, echo_held_ns;
    int width;                    /* FORTH, BACK: how many numbers */
    double number[MOST_NUMBERS];
    int64_t tick_0_ns;            /* START */
    Text text;                    /* REFUSE, BYE, RENEW: the sentence; HELLO, WELCOME: the map as it stands */
    int stamped;                  /* is there an E_in */
    double E_in;
} Packet;

/* NULL and a packet, or why a datagram is none, in the words of WIRE.md. `width`: numbers in a message, exactly. */
const char *decode(const uint8_t *data, size_t size, int width, Packet *out);
/* The size of the datagram in `out` (MOST_CONTROL bytes), padded with zeros to `least`; 0 if it does not fit. */
size_t encode(const Packet *packet, size_t least, uint8_t *out);
/* Do two maps of texts have the same entries? Those whose name begins with "@" are left out. */
int same_entries(Text one, Text other);
/* Has a map this very entry? */
int has_entry(Text map, const char *name, const char *value);
/* The whole number that an entry such as "@tick 0" tells; 0 if there is none. */
int told(Text map, const char *name, int64_t *out);
#endif
