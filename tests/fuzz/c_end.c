/* Hostile datagrams at one end of scenarios/examples/c/end.c, in time that this program counts itself.

       c_end slave|master DATAGRAMS SEED

   Whoever fires knows the session, the manifest and the cookies, and writes clocks, numbers and entries as he likes;
   every fourth datagram has bytes that nobody meant. It prints what the end took, and leaves with 1 where a force was
   not finite or beyond the cap. */
#define main end_main
#include "end.c"
#undef main
#include "wire.c"

static uint64_t state_of_dice;

static uint64_t dice(uint64_t below) { /* xorshift64* */
    state_of_dice ^= state_of_dice >> 12;
    state_of_dice ^= state_of_dice << 25;
    state_of_dice ^= state_of_dice >> 27;
    return (state_of_dice * 0x2545F4914F6CDD1DULL >> 11) % below;
}

static int64_t hostile_ns(int64_t near) { /* a clock: mostly one that is believed, else at an edge of 64 bits */
    static const int64_t edges[] = {INT64_MIN, INT64_MIN + 1, INT64_MAX, INT64_MAX - 1, -(1LL << 61) - 1, -(1LL << 61),
                                    1LL << 61, (1LL << 61) + 1, -(1LL << 62), 1LL << 62, 0, -1};
    uint64_t which = dice(8);
    if (which > 1) return near + (int64_t)dice(3 * MS) - MS;
    return which ? edges[dice(sizeof edges / sizeof *edges)] : (int64_t)(dice(1ULL << 53) << 11);
}

static double hostile_number(double near) {
    static const double edges[] = {0.0, -0.0, 1e-308, 1e15, 1e300, -1e308, 0.03, -1.0};
    return dice(500) ? near * (double)dice(2) + 1e-3 * (double)dice(1000) : edges[dice(8)];
}

static Text entries_of(void) { /* the manifest, with entries that tell a grid or a rate */
    static uint8_t map[MOST_CONTROL];
    static char value[32];
    size_t size = manifest.size;
    int more = 0;
    if (!dice(16)) return (Text){manifest.at, manifest.size - 1};
    memcpy(map, manifest.at, size);
    for (int n = (int)dice(3); n > 0; n--) {
        int grid = (int)dice(2);
        const char *name = grid ? "\xA7@tick 0" : "\xA6@every";
        int digits = snprintf(value, sizeof value, "%lld", (long long)(grid || !dice(4) ? hostile_ns(start_ns) : 1));
        size_t letters = grid ? 8 : 7;
        memcpy(map + size, name, letters);
        map[size + letters] = (uint8_t)(0xA0 + digits);
        memcpy(map + size + letters + 1, value, (size_t)digits);
        size += letters + 1 + (size_t)digits;
        more++;
    }
    int n = manifest.at[1] << 8 | manifest.at[2];
    map[1] = (uint8_t)((n + more) >> 8);
    map[2] = (uint8_t)(n + more);
    return (Text){map, size};
}

static Packet hostile(int64_t now) {
    static const int at_master[] = {WELCOME, WELCOME, START, BACK, BACK, BACK, BACK, RENEW, REFUSE, BYE};
    static const int at_slave[] = {HELLO, HELLO, START, START, FORTH, FORTH, FORTH, FORTH, BYE, RENEW};
    Packet packet = {.kind = master ? at_master[dice(7)] : at_slave[dice(8)], .session = session, .width = width};
    if (state == RUNNING && dice(100)) packet.kind = master ? BACK : FORTH;
    if (!dice(200)) packet.kind = (int)dice(8);
    if (!dice(100) || (!master && packet.kind == HELLO)) packet.session += dice(20);
    int64_t tick = met ? (now - start_ns) / DT : 0;
    packet.seq = (uint32_t)(dice(16) ? tick + (int64_t)dice(3) - 1 : (int64_t)dice(1ULL << 32));
    packet.sent_ns = hostile_ns(now + offset_ns);
    packet.echoes = dice(8) != 0;
    packet.echo_sent_ns = hostile_ns(now - 2 * MS);
    packet.echo_held_ns = dice(4) ? (int64_t)dice(MS) : hostile_ns(0) & INT64_MAX;
    if (packet.kind == START && !master && welcomes && dice(4)) { /* with the cookie */
        size_t newest_one = (welcomes - 1) % WELCOMES;
        packet.session = welcomed[newest_one].session;
        packet.echo_sent_ns = welcomed[newest_one].sent_ns;
    }
    packet.tick_0_ns = dice(3) ? now - (int64_t)dice(40 * MS) : hostile_ns(now);
    const double *old = newest.seq < 0 ? (const double[MOST_NUMBERS]){0} : newest.packet.number;
    for (int i = 0; i < width; i++) packet.number[i] = hostile_number(old[i]);
    if (integrals && dice(4)) { /* what waves come to, as it would be */
        double ticks = newest.seq < 0 ? (double)tick + 1.0 : (double)(tick - newest.seq);
        double wave = 0.01 * (double)dice(100);
        packet.seq = (uint32_t)tick;
        packet.number[0] = wave;
        packet.number[1] = old[1] + ticks * 1e-3 * wave;
        packet.number[2] = old[2] + ticks * 0.5e-3 * wave * wave;
        packet.number[3] = old[3] + ticks * 1e-3;
    }
    if (packet.kind == HELLO || packet.kind == WELCOME) packet.text = entries_of();
    else if (packet.kind > START) packet.text = (Text){(const uint8_t *)"so", 2};
    return packet;
}

static void fire(int64_t now) {
    static uint8_t room[MOST_CONTROL];
    Packet packet = hostile(now);
    struct sockaddr_in from = peer;
    if (!dice(64)) from.sin_port++;
    size_t size = encode(&packet, packet.kind == HELLO ? SHORTEST : 0, room);
    if (!dice(4)) for (int n = (int)dice(4); n >= 0; n--) room[dice(size)] = (uint8_t)dice(256);
    if (!dice(64)) size = dice(size + 1);
    else if (size >= 4 && dice(16)) {
        Out end = {room + size - 4, room + size, 0};
        put(&end, crc32(room, size - 4), 4);
    }
    uint8_t *bytes = malloc(size ? size : 1); /* exactly as long, so that a read beyond it is seen */
    if (!bytes) exit(3);
    memcpy(bytes, room, size);
    receive(bytes, size, &from, now);
    free(bytes);
}

int main(int words, char **word) {
    long ran = 0, driven = 0, left = words > 2 ? atol(word[2]) : 0;
    if (words < 4 || !freopen("/dev/null", "w", stderr)) return 2; /* it tells each session */
    state_of_dice = strtoull(word[3], NULL, 10) * 2 + 1;
    sock = -1; /* what it answers goes nowhere */
    peer.sin_port = 7;
    for (int64_t now = 1LL << 40; left > 0; now += DT + (dice(2000) ? 0 : (int64_t)dice(2000 * MS))) {
        for (int n = (int)dice(20); n > 0 && left > 0; n--, left--) fire(now);
        due(now);
        if (met) {
            int64_t k = now < start_ns ? -1 : (now - start_ns) / DT;
            if (k > last_k) { tick(k, now); ran++; }
        }
        if (!isfinite(answer.force[0]) || fabs(answer.force[0]) > OF(_of_scene)()->guard.caps.at[0].f_max) return 1;
        driven += holds_force();
        if (stopped && !holds_force()) stopped = 0; /* as if it were started again */
        ended = 0;
    }
    printf("{\"met\": %d, \"over\": %ld, \"received\": %ld, \"rejected\": %ld, \"sent\": %ld, \"ticks\": %ld, "
           "\"driven\": %ld}\n", met, sessions_over, received, rejected, sent, ran, driven);
    return 0;
}
