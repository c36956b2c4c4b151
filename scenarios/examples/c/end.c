/* One end of a teleoperation in C, slave or master, around the law and the guard that `teleop emit` has printed.

       end slave|master ADDRESS PORT SECONDS [LOG]

   It is compiled for one printed end: cc -DEND=hard_wall_s ... See README.md beside this. Only `device_read` and
   `device_hold` know what stands at this end: here simulated bodies, with walls at the slave's and hands at the
   master's. */
#define _POSIX_C_SOURCE 200809L
#include "wire.h"

#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)
#define OF(word) JOIN(END, word) /* a word of the printed end, as in OF(_step) */
#define QUOTE_(x) #x
#define QUOTE(x) QUOTE_(x)
#include QUOTE(JOIN(END, _wire.h))

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
enum { AXES = OF(_axes), PACKET = OF(_bytes), SHORTEST = 1200, ROOM = 96, WELCOMES = 256, ROUNDS = 5, NEXT = 16, MOST_EVERY = 1000 };
enum { DELAY = OF(_delay), AHEAD = 256, SLOTS = DELAY ? DELAY + AHEAD : 1 };
static const int64_t DT = OF(_tick_ns), RENEW_AFTER = OF(_renew_ns), AGAIN = 50 * MS, LEAD = 150 * MS, MOST_RTT = 60000 * MS;
static const int64_t MOST_CLOCK = 1LL << 61; /* beyond that, either way, a clock is not believed */
static const int64_t EARLY = 200 * MS; /* a message from further ahead than that is not believed */

static volatile sig_atomic_t stopped; /* 1: its time is over; 2: refused; 3: not finite; 4: by a signal */
enum { master = OF(_is_master), width = OF(_hears), integrals = OF(_integrals) };
static int sock, state, ended;
static const Text manifest = {OF(_manifest), sizeof OF(_manifest)};
static struct sockaddr_in peer, asked; /* whom this end has met, and where a master asks */
static uint64_t session, former;
static int64_t start_ns, begun_ns, again_ns, heard_ns, unheard_ns, first_ns = 2000 * MS; /* heard 0: nothing yet */
static int64_t rtt_ns, offset_ns, since_ns, welcome_ns; /* of a master's exchange */
static int rounds, met, answered, early;
static struct { uint64_t session; int64_t sent_ns, every; } welcomed[WELCOMES]; /* of a slave: who may START */
static size_t welcomes;
static struct { int64_t seq, sent_ns, came_ns; Packet packet; } newest; /* seq -1: none in this session */
static struct { int64_t seq; double number[MOST_NUMBERS]; } played, waiting[SLOTS]; /* the message that is played, seq -1:
    none yet; of a fixed playout those that wait for their tick, each in the place of its number */
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

/* The device: replace these two by your driver's. x in m, v in m/s, f in N, one number an axis. */

static double body_x[AXES], body_v[AXES], body_f[AXES];

static void device_read(double t, double *x, double *v) {
    for (int i = 0; i < AXES; i++) {
        double mass = 0.5, push; /* the hand's or the wall's force, and the motor's */
        if (master) push = 200.0 * (0.02 * (1.0 - cos((3.0 + i) * t)) - body_x[i]) - 5.0 * body_v[i] - body_f[i];
        else push = body_f[i] - body_v[i] - (body_x[i] > 0.03 ? 2000.0 * (body_x[i] - 0.03) + 10.0 * body_v[i] : 0.0);
        body_v[i] += push / mass * (double)DT / 1e9;
        body_x[i] += body_v[i] * (double)DT / 1e9;
        x[i] = body_x[i];
        v[i] = body_v[i];
    }
}

static void device_hold(const double *f) { memcpy(body_f, f, sizeof body_f); }

/* The printed end: law, stages and guard. Its positions count from where the session began. */

static OF(_end) end;
static OF(_moment) moment;
static OF(_answer) answer;
static int begun_of; /* the session that it was begun for */
static double before[MOST_NUMBERS]; /* the integrals of waves that came before this session's first message */
static int based, joined;

static int holds_force(void) { /* does the motor hold any */
    for (int i = 0; i < AXES; i++) if (answer.force[i] != 0.0) return 1;
    return 0;
}

static void hear(int64_t k) { /* the message that tick k plays, for the printed end */
    double number[MOST_NUMBERS];
    int64_t slot = k < DELAY ? 0 : (k - DELAY) % SLOTS;
    moment.got = DELAY ? k >= DELAY && waiting[slot].seq == k - DELAY : newest.seq >= 0;
    if (!moment.got) return;
    played.seq = DELAY ? k - DELAY : newest.seq;
    memcpy(played.number, DELAY ? waiting[slot].number : newest.packet.number, sizeof played.number);
    memcpy(number, played.number, sizeof number);
    if (!based && joined) /* a peer that was there before us has sent waves that are not ours to play */
        memcpy(before, number, sizeof before);
    based = 1;
    for (int i = width - integrals; i < width; i++) number[i] -= before[i];
    OF(_take)(&moment, number);
    moment.number = (uint32_t)played.seq;
}

/* The session */

static void out(Packet *packet, int64_t now, size_t least, const struct sockaddr_in *to) {
    uint8_t data[MOST_CONTROL];
    packet->sent_ns = now;
    size_t size = encode(packet, least, data);
    if (size) (void)sendto(sock, data, size, 0, (const struct sockaddr *)to, sizeof *to);
}

static void say(int kind, uint64_t number, int code, const char *why, int64_t now) { /* BYE, RENEW, START, HELLO */
    Packet packet = {.kind = kind, .session = number, .seq = (uint32_t)code};
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
    joined = tick_0 < now || met > 0;
    start_ns = tick_0;
    state = new_state;
    met++;
    begun_ns = (tick_0 > now ? tick_0 : now) + rtt_ns;
    heard_ns = unheard_ns = 0;
    answered = early = ended = 0;
    newest.seq = played.seq = -1;
    for (int i = 0; i < SLOTS; i++) waiting[i].seq = -1;
    last_k = (now - start_ns) / DT - (tick_0 > now);
    if (last_k < -1) last_k = -1;
    based = 0;
    memset(before, 0, sizeof before);
    fprintf(stderr, "met %d, session %016llx\n", met, (unsigned long long)session);
}

static int is_silent(int64_t now) {
    return heard_ns ? now - heard_ns > RENEW_AFTER : now - begun_ns > (master ? first_ns : RENEW_AFTER);
}

static int is_free(int64_t now) { return !met || (!holds_force() && (state == OVER || is_silent(now))); }

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
    if (rounds < ROUNDS) { say(HELLO, session, NO_CODE, NULL, now); return; }
    int64_t tick_0 = has ? theirs - offset_ns : now + LEAD + 2 * rtt_ns;
    if (met && start_ns < tick_0) tick_0 = start_ns; /* the grid that is further on: ticks are never taken back */
    begin(tick_0, now, STARTING);
    say(START, session, NO_CODE, NULL, now);
}

static int adds_up(const double *new, const double *old, int64_t ticks) { /* what waves have come to: WIRE.md */
    double t = new[width - 1] - old[width - 1], slack = 1e-15 * (double)ticks, dt = (double)DT / 1e9;
    double least = (double)(every < ticks ? every : ticks) * dt * (1.0 - 1e-6);
    if (!(t >= least && t <= (double)ticks * dt * (1.0 + 1e-6))) return 0;
    for (int i = width - integrals; i + 1 < width; i += 2) {
        double u = fabs(new[i] - old[i]) - slack * (fabs(new[i]) + fabs(old[i]));
        double e = new[i + 1] - old[i + 1] + slack * (new[i + 1] + old[i + 1]);
        if (!(e >= 0.0 && (u <= 0.0 || u * u <= 2.0 * (1.0 + 1e-9) * t * e))) return 0;
    }
    return 1;
}

static void data(const Packet *in, int64_t now) {
    static const double nothing[MOST_NUMBERS];
    int64_t tick = (now - start_ns) / DT, seq = tick + (int32_t)(in->seq - (uint32_t)tick);
    if (seq > tick + (EARLY + rtt_ns / 2) / DT) { /* we stood still, or it is no message of this run */
        rejected++;
        if (++early > 3 * every) end_session("its messages are ahead of this end's clock");
        return;
    }
    int overtaken = seq <= newest.seq, late = seq + DELAY <= last_k || seq >= tick + AHEAD;
    if (seq < 0 || (overtaken && (!DELAY || late || waiting[seq % SLOTS].seq == seq))) return; /* or a copy */
    const double *now_has = in->number, *had = newest.seq < 0 ? nothing : newest.packet.number;
    if (integrals && !adds_up(overtaken ? had : now_has, overtaken ? now_has : had,
                              newest.seq < 0 ? seq + every : llabs(seq - newest.seq))) { rejected++; return; }
    received++;
    if (DELAY && !late) {
        waiting[seq % SLOTS].seq = seq;
        memcpy(waiting[seq % SLOTS].number, in->number, sizeof in->number);
    }
    if (overtaken) return;
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
    if (state == OVER && master && !holds_force() && !stopped && !ended) {
        former = session++;
        rounds = 0;
        first_ns = answered ? 2000 * MS : first_ns * 2 > MOST_RTT ? MOST_RTT : first_ns * 2;
        state = MEETING;
        again_ns = 0;
    }
    if (now < again_ns) return;
    if (master && state == MEETING) say(HELLO, session, NO_CODE, NULL, now);
    else if (state == STARTING || (master && state == OVER)) say(START, session, NO_CODE, NULL, now);
    else if (state == OVER && !ended) say(RENEW, session, NO_CODE, "the session is over", now);
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
    static const double zero[AXES];
    Packet message = {.kind = master ? FORTH : BACK, .session = session, .seq = (uint32_t)k, .width = OF(_sends)};
    device_read((double)k * (double)DT / 1e9, moment.x, moment.v);
    if (begun_of != met) {
        OF(_begin)(&end, OF(_of_scene)(), (uint32_t)k, moment.x, moment.v, zero, moment.x);
        begun_of = met;
    }
    moment.k = (uint32_t)k;
    moment.ready = 1;
    hear(k);
    moment.unheard = answered ? (double)unheard_ns / 1e9 : INFINITY;
    moment.over = state == OVER || stopped;
    OF(_step)(&end, OF(_of_scene)(), &moment, &answer);
    if (answer.reason == OF(_no_law)) stopped = 3;
    last_k = k;
    device_hold(answer.force);
    if (answer.send) OF(_give)(&answer, message.number);
    if (log_file) {
        const double *came = played.number, *say_it = message.number;
        fprintf(log_file, "%d,%lld,%.17g,%.17g,%.17g,%.17g,%lld,", met, (long long)k, moment.x[0] - end.origin[0],
                moment.v[0], answer.force[0], end.guard.gain, (long long)played.seq);
        fprintf(log_file, "%.17g,%.17g,%.17g,%.17g\n", came[0], came[1], say_it[0], say_it[1]);
    }
    if (!master) follow(k);
    if (!answer.send || (state != STARTING && state != RUNNING)) return;
    message.echoes = newest.seq >= 0;
    message.echo_sent_ns = newest.sent_ns;
    message.echo_held_ns = now - newest.came_ns;
    out(&message, now, PACKET, &peer);
    sent++;
}

static void stop(int number) { (void)number; stopped = 4; }

int main(int words, char **word) {
    static uint8_t bytes[MOST_CONTROL + 1];
    struct sockaddr_in here = {.sin_family = AF_INET}, from;
    struct sigaction act = {.sa_handler = stop};
    socklen_t size = sizeof here;
    if (words < 5 || strcmp(word[1], master ? "master" : "slave")
        || inet_pton(AF_INET, word[2], &here.sin_addr) != 1) {
        fprintf(stderr, "type: end %s ADDRESS PORT SECONDS [LOG], the address as in 127.0.0.1\n",
                master ? "master" : "slave");
        return 2;
    }
    here.sin_port = htons((uint16_t)atoi(word[3]));
    int64_t until = now_ns() + (int64_t)(atof(word[4]) * 1e9);
    log_file = words > 5 ? fopen(word[5], "w") : NULL;
    sock = socket(AF_INET, SOCK_DGRAM, 0);
    if (sock < 0 || (!master && bind(sock, (struct sockaddr *)&here, sizeof here))
        || fcntl(sock, F_SETFL, O_NONBLOCK)) {
        perror("the socket");
        return 1;
    }
    peer = asked = here;
    if (master) {
        FILE *file = fopen("/dev/urandom", "rb");
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
        if (stopped && !holds_force()) break;
        struct timespec t = {next / (1000 * MS), next % (1000 * MS)};
        while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL) == EINTR) {}
    }
    memset(answer.force, 0, sizeof answer.force);
    device_hold(answer.force);
    int code = stopped == 1 ? FINISHED : NO_CODE;
    if (met || master) say(BYE, session, code, code ? "finished" : "stopped", now_ns());
    if (former && state == MEETING) say(BYE, former, NO_CODE, "stopped", now_ns());
    printf("{\"met\": %d, \"over\": %ld, \"received\": %ld, \"sent\": %ld, \"rejected\": %ld}\n", met, sessions_over,
           received, sent, rejected);
    if (log_file) fclose(log_file);
    return stopped == 1 || stopped == 4 ? 0 : stopped;
}
