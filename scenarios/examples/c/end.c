/* One end of a teleoperation in C, slave or master, of one axis: position-position or waves. See README.md beside this.

       end slave|master ADDRESS PORT MANIFEST SECONDS [LOG]

   MANIFEST is written by `teleop manifest SCENE --write MANIFEST`. Only `device_read` and `device_hold` know what
   stands at this end: here a simulated body, with a wall at the slave's and a hand at the master's. */
#define _POSIX_C_SOURCE 200809L
#include "wire.h"

#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#define MS 1000000LL
enum { MEETING, STARTING, RUNNING, OVER }; /* MEETING: a slave listens, a master asks */
enum { PACKET = 100, SHORTEST = 1200, ROOM = 96, WELCOMES = 256, ROUNDS = 5, NEXT = 16, MOST_EVERY = 1000 };
static const int64_t DT = MS, AGAIN = 50 * MS, RENEW_AFTER = 1000 * MS, LEAD = 150 * MS, MOST_RTT = 60000 * MS;
static const int64_t MOST_CLOCK = 1LL << 61; /* beyond that, either way, a clock is not believed */
static const int64_t EARLY = 200 * MS; /* a message from further ahead than that is not believed */
static const double TIMEOUT = 0.2, RAMP = 0.05, SETTLE = 0.1; /* s, of the watchdog */
static const double F_MAX = 20.0, SLEW = 2000.0;             /* N, N/s */
static const char *PP = "pp PositionPosition(K=400.0, B=4.0, rejoin=2.0)";
static const char *WAVE = "wave Wave(b=20.0, K=1000.0, B=20.0)";

static volatile sig_atomic_t stopped; /* 1: its time is over; 2: refused; 3: not finite; 4: by a signal */
static int sock, master, waves, width, state, ended;
static Text manifest;
static struct sockaddr_in peer, asked; /* whom this end has met, and where a master asks */
static uint64_t session, former;
static int64_t start_ns, begun_ns, again_ns, heard_ns, unheard_ns, first_ns = 2000 * MS; /* heard 0: nothing yet */
static int64_t rtt_ns, offset_ns, since_ns, welcome_ns; /* of a master's exchange */
static int rounds, met, answered, early;
static struct { uint64_t session; int64_t sent_ns, every; } welcomed[WELCOMES]; /* of a slave: who may START */
static size_t welcomes;
static struct { int64_t seq, sent_ns, came_ns; Packet packet; } newest; /* seq -1: none in this session */
static int64_t every = 1, last_k; /* the peer ticks at every so many ticks; the tick that ran here last */
static long received, sent, rejected, sessions_over;
static FILE *log_file;

static int64_t now_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * 1000 * MS + t.tv_nsec;
}

static int is_clock(int64_t ns) { return ns >= -MOST_CLOCK && ns <= MOST_CLOCK; }

static int64_t round_trip(const Packet *in, int64_t now) { /* of an echo that came at `now`; -1 if it is not believed */
    if (!in->echoes || !is_clock(in->echo_sent_ns) || !is_clock(in->echo_held_ns)) return -1;
    int64_t rtt = now - in->echo_sent_ns - in->echo_held_ns; /* of three clocks: it fits */
    return rtt < 0 || rtt > MOST_RTT ? -1 : rtt;
}

/* The device: replace these two by your driver's. x in m, v in m/s, f in N. */

static double body_x, body_v, body_f;

static void device_read(double t, double *x, double *v) {
    double mass = 0.5, push; /* the hand's or the wall's force, and the motor's */
    if (master) push = 200.0 * (0.02 * (1.0 - cos(3.0 * t)) - body_x) - 5.0 * body_v - body_f;
    else push = body_f - 1.0 * body_v - (body_x > 0.03 ? 2000.0 * (body_x - 0.03) + 10.0 * body_v : 0.0);
    body_v += push / mass * DT / 1e9;
    body_x += body_v * DT / 1e9;
    *x = body_x;
    *v = body_v;
}

static void device_hold(double f) { body_f = f; }

/* The laws: teleop/laws/pp.py and wave.py. Waves are played by their integral, within the energy that came. */

static double origin, offset, gain, x_d, v_d, force; /* of the law; positions count from `origin` */
static double T, U, E, q, P, G, p, T0, U0, E0;       /* waves sent, waves played, and what had come before */
static int based, joined;
static double quiet; /* s of fresh messages */

static void begin_law(void) {
    origin = body_x;
    offset = x_d = v_d = T = U = E = q = P = G = p = T0 = U0 = E0 = quiet = 0.0;
    based = !joined && met == 1; /* a peer that was there before us has sent waves that are not ours to play */
    gain = met == 1 && !joined ? 1.0 : 0.0;
}

static double play(double span) { /* the received wave: all that is owed, in one tick if its energy allows it */
    const double *came = newest.seq < 0 ? NULL : newest.packet.number, dt = DT / 1e9;
    if (came && !based) { U0 = came[1]; E0 = came[2]; T0 = came[3]; based = 1; }
    P += (span - dt) * p;
    G += (span - dt) * 0.5 * p * p;
    double owed = came ? came[1] - U0 - P : 0.0, left = came ? fmax(came[2] - E0 - G, 0.0) : 0.0;
    p = left > 0.0 ? owed / fmax(dt, owed * owed / (2.0 * left)) : 0.0;
    P += dt * p;
    G += dt * 0.5 * p * p;
    return p;
}

static double law(double x, double v, double span, double *message) {
    const double *came = newest.seq < 0 ? NULL : newest.packet.number, dt = DT / 1e9;
    if (!waves) {
        double K = 400.0, B = 4.0, rejoin = 2.0, rx = came ? came[0] : 0.0, rv = came ? came[1] : 0.0;
        double apart = master ? x - rx : rx - x, faster = master ? v - rv : rv - v;
        offset = (offset + (1.0 - gain) * (apart - offset)) * fmax(1.0 - rejoin * span, 0.0);
        message[0] = x;
        message[1] = v;
        return K * (apart - offset) + B * faster;
    }
    double b = 20.0, K = 1000.0, B = 20.0, root = sqrt(2.0 * b), wave = play(span), f, out;
    if (master) {
        f = b * v - root * wave;
        out = root * v - wave;
    } else {
        x_d += (span - dt) * v_d;
        v_d = (root * wave - gain * (K * (x_d - x) - B * v)) / ((2.0 - gain) * b + gain * (B + K * dt));
        x_d += dt * v_d;
        f = K * (x_d - x) + B * (v_d - v);
        out = wave - 2.0 / root * (gain * f + (1.0 - gain) * b * v_d);
    }
    T += span;
    U += (span - dt) * q + dt * out;
    E += (span - dt) * 0.5 * q * q + dt * 0.5 * out * out;
    q = message[0] = out;
    message[1] = U;
    message[2] = E;
    message[3] = T;
    return f;
}

/* The session */

static void out(Packet *packet, int64_t now, size_t least, const struct sockaddr_in *to) {
    uint8_t data[MOST_CONTROL];
    packet->sent_ns = now;
    size_t size = encode(packet, least, data);
    if (size) (void)sendto(sock, data, size, 0, (const struct sockaddr *)to, sizeof *to);
}

static void say(int kind, uint64_t number, const char *why, int64_t now) { /* BYE, RENEW, START, HELLO */
    Packet packet = {.kind = kind, .session = number};
    if (why) packet.text = (Text){(const uint8_t *)why, strlen(why)};
    if (kind == HELLO) packet.text = manifest;
    if (kind == START) {
        packet.tick_0_ns = start_ns + offset_ns;
        packet.echoes = 1;
        packet.echo_sent_ns = welcome_ns;
    }
    size_t padded = manifest.size + 40 + ROOM;
    again_ns = now + AGAIN;
    out(&packet, now, kind != HELLO ? 0 : padded > SHORTEST ? padded : SHORTEST, kind == HELLO ? &asked : &peer);
}

static void end_session(const char *why) {
    if (state != STARTING && state != RUNNING) return;
    fprintf(stderr, "the session is over: %s\n", why);
    state = OVER;
    sessions_over++;
    again_ns = 0;
}

static void begin(int64_t tick_0, int64_t now, int new_state) {
    joined = tick_0 < now;
    start_ns = tick_0;
    state = new_state;
    met++;
    begun_ns = (tick_0 > now ? tick_0 : now) + rtt_ns;
    heard_ns = unheard_ns = 0;
    answered = early = ended = 0;
    newest.seq = -1;
    last_k = (now - start_ns) / DT - (tick_0 > now);
    if (last_k < -1) last_k = -1;
    begin_law();
    fprintf(stderr, "met %d, session %016llx\n", met, (unsigned long long)session);
}

static int is_silent(int64_t now) {
    return heard_ns ? now - heard_ns > RENEW_AFTER : now - begun_ns > (master ? first_ns : RENEW_AFTER);
}

static int is_free(int64_t now) { return !met || (force == 0.0 && (state == OVER || is_silent(now))); }

static int64_t rate(Text entries) { /* a peer ticks at every so many ticks of the grid */
    int64_t n;
    return told(entries, "@every", &n) && n >= 1 && n <= MOST_EVERY ? n : 1;
}

static void hello(const Packet *in, size_t size, const struct sockaddr_in *from, int64_t now) {
    if (!is_free(now)) {
        if (in->session - session - 1 < NEXT) end_session("the master asks for another");
        return;
    }
    Packet reply = {.kind = WELCOME, .session = in->session, .echoes = 1, .echo_sent_ns = in->sent_ns};
    uint8_t entries[MOST_CONTROL];
    char tick_0[32];
    if (!same_entries(in->text, manifest)) {
        const char *why = "the slave is set up for another run: compare what `teleop manifest` prints at both ends";
        reply = (Packet){.kind = REFUSE, .session = in->session, .text = {(const uint8_t *)why, strlen(why)}};
    } else if (met) { /* this end has the grid, and tells it: one more entry in the map, which has 16 to 65,534 */
        int digits = snprintf(tick_0, sizeof tick_0, "%lld", (long long)start_ns);
        int n = manifest.at[1] << 8 | manifest.at[2];
        memcpy(entries, manifest.at, manifest.size);
        entries[1] = (uint8_t)((n + 1) >> 8);
        entries[2] = (uint8_t)(n + 1);
        memcpy(entries + manifest.size, "\xA7@tick 0", 8);
        entries[manifest.size + 8] = (uint8_t)(0xA0 + digits);
        memcpy(entries + manifest.size + 9, tick_0, (size_t)digits);
        reply.text = (Text){entries, manifest.size + 9 + (size_t)digits};
    } else reply.text = manifest;
    if (reply.kind == WELCOME) {
        welcomed[welcomes % WELCOMES].session = in->session;
        welcomed[welcomes % WELCOMES].sent_ns = now;
        welcomed[welcomes++ % WELCOMES].every = rate(in->text);
    }
    if (manifest.size + 80 <= size) out(&reply, now, 0, from); /* never longer than what it answers */
}

static void start(const Packet *in, const struct sockaddr_in *from, int64_t now) {
    if (in->tick_0_ns > now + LEAD + 3 * MOST_RTT || in->tick_0_ns < -MOST_CLOCK) return;
    if (in->session != session || !met) {
        size_t i = 0;
        while (i < WELCOMES && !(welcomed[i].sent_ns && welcomed[i].session == in->session &&
                                 welcomed[i].sent_ns == in->echo_sent_ns)) i++;
        if (i == WELCOMES || !in->echoes || !is_free(now)) return;
        session = in->session;
        every = welcomed[i].every;
        peer = *from;
        begin(in->tick_0_ns, now, RUNNING);
    }
    Packet reply = {.kind = START, .session = session, .tick_0_ns = in->tick_0_ns};
    out(&reply, now, 0, &peer);
}

static void welcome(const Packet *in, int64_t now) {
    int64_t rtt = round_trip(in, now), theirs = 0;
    if (!same_entries(in->text, manifest)) {
        fprintf(stderr, "the slave is set up for another run: compare what `teleop manifest` prints at both ends\n");
        stopped = 2;
        return;
    }
    if (rtt < 0 || !is_clock(in->sent_ns)) return;
    if (!rounds || rtt < rtt_ns - MS) { rounds = 1; since_ns = now; }
    else if (in->echo_sent_ns >= since_ns) rounds++;
    if (rounds == 1 || rtt < rtt_ns) { rtt_ns = rtt; offset_ns = in->sent_ns - (now - rtt / 2); }
    every = rate(in->text);
    welcome_ns = in->sent_ns;
    int has = told(in->text, "@tick 0", &theirs);
    if (has && (theirs - offset_ns > now + LEAD + 3 * MOST_RTT || theirs - offset_ns < -MOST_CLOCK)) return;
    if (rounds < ROUNDS) { say(HELLO, session, NULL, now); return; }
    int64_t tick_0 = has ? theirs - offset_ns : now + LEAD + 2 * rtt_ns;
    if (met && start_ns < tick_0) tick_0 = start_ns; /* the grid that is further on: ticks are never taken back */
    begin(tick_0, now, STARTING);
    say(START, session, NULL, now);
}

static int adds_up(const double *new, const double *old, int64_t ticks) { /* what waves have come to: WIRE.md */
    double t = new[3] - old[3], u = fabs(new[1] - old[1]), e = new[2] - old[2], slack = 1e-15 * (double)ticks;
    u -= slack * (fabs(new[1]) + fabs(old[1]));
    e += slack * (new[2] + old[2]);
    double least = (double)(every < ticks ? every : ticks) * 1e-3 * (1.0 - 1e-6);
    return t >= least && t <= (double)ticks * 1e-3 * (1.0 + 1e-6) && e >= 0.0 &&
           (u <= 0.0 || u * u <= 2.0 * (1.0 + 1e-9) * t * e);
}

static void data(const Packet *in, int64_t now) {
    static const double nothing[4];
    int64_t tick = (now - start_ns) / DT, seq = tick + (int32_t)(in->seq - (uint32_t)tick);
    if (seq > tick + (EARLY + rtt_ns / 2) / DT) { /* we stood still, or it is no message of this run */
        rejected++;
        if (++early > 3 * every) end_session("its messages are ahead of this end's clock");
        return;
    }
    if (seq < 0 || seq <= newest.seq) return; /* overtaken, or a copy: what is newer was taken */
    if (waves && !adds_up(in->number, newest.seq < 0 ? nothing : newest.packet.number,
                          newest.seq < 0 ? seq + every : seq - newest.seq)) { rejected++; return; }
    received++;
    early = 0;
    newest.seq = seq;
    newest.sent_ns = in->sent_ns;
    newest.came_ns = heard_ns = now;
    newest.packet = *in;
    if (state == STARTING) state = RUNNING;
    if (!in->echoes) unheard_ns = start_ns + seq * DT - begun_ns;
    else if (round_trip(in, now) >= 0) {
        answered = 1;
        unheard_ns = in->echo_held_ns;
        if (unheard_ns > RENEW_AFTER) end_session("nothing of this end arrives at the other");
    }
}

static void receive(const uint8_t *bytes, size_t size, const struct sockaddr_in *from, int64_t now) {
    static Packet in;
    int known = from->sin_addr.s_addr == peer.sin_addr.s_addr && from->sin_port == peer.sin_port;
    if (decode(bytes, size, width, &in)) { rejected++; return; }
    int ours = in.session == session && known && (master || met);
    if (in.kind == HELLO && !master) hello(&in, size, from, now);
    else if (in.kind == START && !master && (known || is_free(now))) start(&in, from, now);
    else if (in.kind == WELCOME && master && in.session == session && state == MEETING) welcome(&in, now);
    else if (in.kind == START && ours) { if (state == STARTING) state = RUNNING; }
    else if (in.kind == (master ? BACK : FORTH) && ours && (state == STARTING || state == RUNNING)) data(&in, now);
    else if (in.kind == RENEW && ours && master) end_session("the slave asks for another");
    else if (in.kind == REFUSE && in.session == session && master && state == MEETING) {
        fprintf(stderr, "%.*s\n", (int)in.text.size, (const char *)in.text.at);
        stopped = 2;
    } else if (in.kind == BYE && ours) { end_session("the other end left"); ended = 1; }
}

static void due(int64_t now) { /* what has to be said again, and whether the session is over */
    if ((state == STARTING || state == RUNNING) && is_silent(now) && (master || heard_ns)) end_session("nothing came");
    if (state == OVER && master && force == 0.0 && !stopped && !ended) {
        former = session++;
        rounds = 0;
        first_ns = answered ? 2000 * MS : first_ns * 2 > MOST_RTT ? MOST_RTT : first_ns * 2;
        state = MEETING;
        again_ns = 0;
    }
    if (now < again_ns) return;
    if (master && state == MEETING) say(HELLO, session, NULL, now);
    else if (state == STARTING || (master && state == OVER)) say(START, session, NULL, now);
    else if (state == OVER && !ended) say(RENEW, session, "the session is over", now);
}

/* A tick: what is sent, and the force that is held until the next */

static void follow(int64_t k) { /* the slave's grid goes with the master's clock, 500 ppm at the most */
    static int64_t from_k, best = INT64_MAX, theta, first_rtt, first_theta, shifted, wanted;
    static int of, windows;
    int64_t rtt = newest.seq < 0 ? -1 : round_trip(&newest.packet, newest.came_ns);
    if (of != met) { of = met; windows = 0; from_k = k; best = INT64_MAX; shifted = wanted = 0; }
    if (rtt >= 0 && rtt < best && is_clock(newest.sent_ns)) {
        best = rtt;
        theta = newest.sent_ns - newest.came_ns + rtt / 2;
    }
    if (k - from_k >= 1000 && best < INT64_MAX) { /* a second: the fastest round trip of each says how the clocks go */
        if (!windows++) { first_rtt = best; first_theta = theta; }
        int64_t moved = first_theta - theta - wanted, ways = llabs(best - first_rtt) / 2 + DT / 2;
        if (llabs(moved) > ways) wanted += moved > 0 ? moved - ways : moved + ways;
        from_k = k;
        best = INT64_MAX;
    }
    int64_t step = wanted - shifted, most = DT / 2000;
    step = step > most ? most : step < -most ? -most : step;
    shifted += step;
    start_ns += step;
}

static void tick(int64_t k, int64_t now) {
    double span = (double)(k - last_k) * DT / 1e9, step = SLEW * DT / 1e9, x, v, f, silent;
    Packet message = {.kind = master ? FORTH : BACK, .session = session, .seq = (uint32_t)k, .width = width};
    device_read((double)k * DT / 1e9, &x, &v);
    silent = (double)(now - (heard_ns ? heard_ns : begun_ns)) / 1e9;
    int well = state != OVER && !stopped && silent <= TIMEOUT && (double)unheard_ns / 1e9 <= TIMEOUT &&
               (double)(k - last_k) * DT / 1e9 <= TIMEOUT;
    quiet = well && heard_ns ? quiet + span : 0.0;
    if (!well) gain = fmax(0.0, gain - span / RAMP);
    else if (gain < 1.0 && answered && quiet > SETTLE) gain = fmin(1.0, gain + DT / 1e9 / RAMP);
    last_k = k;
    f = law(x - origin, v, span, message.number) * gain;
    if (!isfinite(f)) { stopped = 3; gain = f = 0.0; }
    f = fmax(-F_MAX, fmin(F_MAX, f));
    if (gain > 0.0) f = fmax(force - step, fmin(force + step, f)); /* one step, however many ticks have passed */
    device_hold(force = f);
    if (log_file) {
        const double *came = newest.packet.number, *say_it = message.number;
        fprintf(log_file, "%d,%lld,%.17g,%.17g,%.17g,%.17g,%.17g,%lld,", met, (long long)k, x - origin, v, force, gain,
                offset, (long long)newest.seq);
        fprintf(log_file, "%.17g,%.17g,%.17g,%.17g\n", came[0], came[1], say_it[0], say_it[1]);
    }
    if (!master) follow(k);
    if (state != STARTING && state != RUNNING) return;
    message.echoes = newest.seq >= 0;
    message.echo_sent_ns = newest.sent_ns;
    message.echo_held_ns = now - newest.came_ns;
    for (int i = 0; i < width; i++) if (!isfinite(message.number[i])) return;
    out(&message, now, PACKET, &peer);
    sent++;
}

static void stop(int number) { (void)number; stopped = 4; }

int main(int words, char **word) {
    static uint8_t entries[MOST_CONTROL / 2], bytes[MOST_CONTROL + 1];
    struct sockaddr_in here = {.sin_family = AF_INET}, from;
    struct sigaction act = {.sa_handler = stop};
    socklen_t size = sizeof here;
    if (words < 6 || (strcmp(word[1], "slave") && strcmp(word[1], "master"))
        || inet_pton(AF_INET, word[2], &here.sin_addr) != 1) {
        fprintf(stderr, "type: end slave|master ADDRESS PORT MANIFEST SECONDS [LOG], the address as in 127.0.0.1\n");
        return 2;
    }
    master = !strcmp(word[1], "master");
    here.sin_port = htons((uint16_t)atoi(word[3]));
    FILE *file = fopen(word[4], "rb");
    manifest = (Text){entries, file ? fread(entries, 1, sizeof entries, file) : 0};
    if (file) fclose(file);
    waves = has_entry(manifest, "law", WAVE);
    width = waves ? 4 : 2;
    if (manifest.size == 0 || entries[0] != 0xDE || !(waves || has_entry(manifest, "law", PP))
        || !has_entry(manifest, "dt", "0.001") || !has_entry(manifest, "axes", "1")
        || !has_entry(manifest, "packet_size", "100") || !has_entry(manifest, "mode", "live")) {
        fprintf(stderr, "%s is no manifest of what this program does, which is one axis, ticks of 1 ms, packets of 100 "
                "bytes and the laws \"%s\" and \"%s\": write it with teleop manifest hard_wall --write %s\n", word[4],
                PP, WAVE, word[4]);
        return 2;
    }
    int64_t until = now_ns() + (int64_t)(atof(word[5]) * 1e9);
    log_file = words > 6 ? fopen(word[6], "w") : NULL;
    sock = socket(AF_INET, SOCK_DGRAM, 0);
    if (sock < 0 || (!master && bind(sock, (struct sockaddr *)&here, sizeof here))
        || fcntl(sock, F_SETFL, O_NONBLOCK)) {
        perror("the socket");
        return 1;
    }
    peer = asked = here;
    if (master) {
        file = fopen("/dev/urandom", "rb");
        if (!file || fread(&session, sizeof session, 1, file) != 1) { perror("/dev/urandom"); return 1; }
        fclose(file);
    } else if (!getsockname(sock, (struct sockaddr *)&here, &size)) printf("listening %d\n", ntohs(here.sin_port));
    fflush(stdout);
    sigaction(SIGINT, &act, NULL);
    sigaction(SIGTERM, &act, NULL);
    for (;;) {
        int64_t now = now_ns(), next = now + DT;
        ssize_t got;
        for (int n = 0; n < 64; n++) {
            size = sizeof from;
            got = recvfrom(sock, bytes, sizeof bytes, 0, (struct sockaddr *)&from, &size);
            if (got >= 0) receive(bytes, (size_t)got, &from, now_ns());
            else if (errno != ECONNREFUSED) break;
        }
        due(now);
        if (now >= until || (master && ended)) stopped = stopped ? stopped : 1;
        if (met) {
            int64_t k = now < start_ns ? -1 : (now - start_ns) / DT;
            if (k > last_k) tick(k, now_ns());
            /* Ticks that this process was late for are left out, never made up for; before tick 0 it goes on listening. */
            if (start_ns + (k + 1) * DT < next) next = start_ns + (k + 1) * DT;
        }
        if (stopped && force == 0.0) break;
        struct timespec t = {next / (1000 * MS), next % (1000 * MS)};
        while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL) == EINTR) {}
    }
    device_hold(0.0);
    if (met || master) say(BYE, session, stopped == 1 ? "finished" : "stopped", now_ns());
    if (former && state == MEETING) say(BYE, former, "stopped", now_ns());
    printf("{\"met\": %d, \"over\": %ld, \"received\": %ld, \"sent\": %ld, \"rejected\": %ld}\n", met, sessions_over,
           received, sent, rejected);
    if (log_file) fclose(log_file);
    return stopped == 1 || stopped == 4 ? 0 : stopped;
}
