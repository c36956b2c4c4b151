/* A forwarder between two ends that throws bad datagrams at them, from where they take it for their peer.
 *
 *   between SLAVE OWN_SLAVE OWN_MASTER STRANGE_SLAVE STRANGE_MASTER
 *
 * `SLAVE` is the slave's port on loopback; its own, for the master, is the first line that it prints. The rest are
 * datagrams a second: from the two sockets that it forwards by, and from one of its own. It throws from the first
 * message on, and prints at SIGTERM how many of each were thrown, and in how many seconds.
 *
 * A process of its own throws, so that the good packets are passed on at once meanwhile.
 */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <poll.h>
#include <sched.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>
enum { MOST = 16, ROOM = 1500, NOISE = 1 << 16, LONGEST = 65536 };
struct good { volatile size_t size; uint8_t data[ROOM]; };
struct flood { int from; double rate; const struct sockaddr_in *to; const struct good *like; long thrown; };
struct shared { struct flood floods[4]; struct sockaddr_in slave, master; volatile double began; struct good like[2]; };
static volatile sig_atomic_t over;
static struct shared *both_know;
static uint8_t noise[NOISE + ROOM], made[MOST][ROOM];
static uint64_t state = 0x9e3779b97f4a7c15u;
static uint32_t dice(void) {
    state ^= state << 13; state ^= state >> 7; state ^= state << 17;
    return (uint32_t)(state >> 32);
}
static void before_others(int priority) {
    sched_setscheduler(0, SCHED_FIFO, &(struct sched_param){ .sched_priority = priority });
}
static void stop(int unused) { (void)unused; over = 1; }
static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec + t.tv_nsec * 1e-9;
}
static size_t bad(uint8_t *out, const struct good *like) {
    size_t size = like->size;
    const uint8_t *random = noise + dice() % NOISE;
    switch (dice() & 3) {
    case 0:
        size = 1 + dice() % 1400;
        memcpy(out, random, size);
        break;
    case 1:
        memcpy(out, like->data, size);
        out[dice() % size] ^= 1 << (dice() & 7);
        break;
    case 2:
        memcpy(out, like->data, size);
        size = dice() % size;
        break;
    default:
        memcpy(out, random, size);
        out[0] = 20 + dice() % 7; out[1] = 0xfe; out[2] = 0xfd; out[3] = 0; out[4] = dice() & 1;
        out[11] = (size - 13) >> 8; out[12] = (size - 13) & 255;
    }
    return size;
}
static void throw_at(struct flood *f, double since) {
    struct mmsghdr all[MOST];
    struct iovec parts[MOST];
    long owed = (long)(f->rate * since) - f->thrown;
    int n = owed > MOST ? MOST : (int)owed;
    if (n <= 0 || f->like->size == 0) return;
    memset(all, 0, sizeof all);
    for (int i = 0; i < n; i++) {
        parts[i] = (struct iovec){ made[i], bad(made[i], f->like) };
        all[i].msg_hdr = (struct msghdr){ .msg_name = (void *)f->to, .msg_namelen = sizeof *f->to,
                                          .msg_iov = &parts[i], .msg_iovlen = 1 };
    }
    sendmmsg(f->from, all, n, 0);
    f->thrown += n;
}
static void keep_throwing(void) {
    const struct timespec pause = { 0, 100000 };
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    before_others(1);
    for (;;) {
        double began = both_know->began;
        nanosleep(&pause, NULL);
        if (began == 0) continue;
        for (int again = 0, most = 2 * MOST; again < most; again++)
            for (int i = 0; i < 4; i++) throw_at(&both_know->floods[i], now() - began);
    }
}
static int opened(void) {
    struct sockaddr_in here = { .sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK) };
    int sock = socket(AF_INET, SOCK_DGRAM | SOCK_NONBLOCK, 0);
    bind(sock, (struct sockaddr *)&here, sizeof here);
    return sock;
}
int main(int argc, char **argv) {
    static uint8_t data[LONGEST];
    struct sockaddr_in at;
    socklen_t length = sizeof at;
    int near = opened(), far = opened(), strange = opened(), from[] = { far, near, strange, strange }, floods = 0;
    struct shared *know = mmap(NULL, sizeof *know, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    if (argc != 6 || know == MAP_FAILED) return 2;
    both_know = know;
    know->slave = (struct sockaddr_in){ .sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK),
                                        .sin_port = htons(atoi(argv[1])) };
    for (int i = 0; i < 4; i++) {
        know->floods[i] = (struct flood){ from[i], atof(argv[i + 2]), i & 1 ? &know->master : &know->slave,
                                          &know->like[i & 1], 0 };
        floods += know->floods[i].rate > 0;
    }
    for (int i = 0; i < NOISE + ROOM; i++) noise[i] = dice();
    if (floods && fork() == 0) keep_throwing();
    before_others(39); /* after the ends, which have 40 */
    signal(SIGTERM, stop);
    alarm(60);
    getsockname(near, (struct sockaddr *)&at, &length);
    printf("%d\n", ntohs(at.sin_port));
    fflush(stdout);
    while (!over) {
        struct pollfd both[] = { { near, POLLIN, 0 }, { far, POLLIN, 0 } };
        if (poll(both, 2, 1000) <= 0) continue;
        for (int i = 0; i < 2; i++) {
            ssize_t n;
            length = sizeof at;
            while ((n = recvfrom(from[1 - i], data, LONGEST, 0, (struct sockaddr *)&at, &length)) >= 0) {
                if (i == 0) know->master = at;
                sendto(from[i], data, n, 0, (struct sockaddr *)(i ? &know->master : &know->slave), sizeof at);
                if (n < 16 || n > ROOM || (data[0] != 23 && (data[0] != 'B' || data[3] > 1))) continue;
                memcpy(know->like[i].data, data, know->like[i].size = n);
                if (know->began == 0) know->began = now();
            }
        }
    }
    for (int i = 0; i < 4; i++) printf("%ld ", know->floods[i].thrown);
    printf("%.6f\n", know->began ? now() - know->began : 0.0);
    return 0;
}
