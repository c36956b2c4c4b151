/* What the benches `timing` and `live` measure the live parts against, and with: a timer loop, a UDP echo and its
 * pinger, a relay with one constant delay, and the load for a relay.
 *
 *   timing tick N [PRIORITY]                   lateness of N ticks of 1 ms: median, 99 %, us; share of a core; most, us;
 *                                              the priority of SCHED_FIFO that it asked for and got, or 0
 *   timing echo                                prints its port; sends back what comes
 *   timing ping PORT N                         N round trips of 100 bytes: median, 99 %, us
 *   timing relay PEER_PORT DELAY_NS            prints its port
 *   timing load FORTH BACK RATE COUNT DELAY_NS prints the slave's port, reads the relay's
 *
 * `load` prints: datagrams lost forth, back; error of the delay, median, 99 %, us. Its files hold datagrams behind their
 * length of 2 bytes (little-endian), the first of them for the session's beginning.
 */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/timerfd.h>
#include <time.h>
#include <unistd.h>

enum { LONGEST = 2048, DEEP = 1 << 16, DRAIN = 16 };
static const int64_t MS = 1000000, S = 1000000000;

static int64_t now(clockid_t which)
{
    struct timespec t;
    clock_gettime(which, &t);
    return t.tv_sec * S + t.tv_nsec;
}

static int order(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static void told(double *us, int n)
{
    qsort(us, n, sizeof *us, order);
    printf("%.2f %.2f", n ? us[n / 2] : 0.0, n ? us[(int)(n * 0.99)] : 0.0);
}

static void set(int timer, int64_t due, int64_t interval)
{
    struct itimerspec spec = {{interval / S, interval % S}, {due / S, due % S}};
    timerfd_settime(timer, TFD_TIMER_ABSTIME, &spec, NULL);
}

static struct sockaddr_in at(int port)
{
    struct sockaddr_in a = {.sin_family = AF_INET, .sin_port = htons(port)};
    a.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    return a;
}

/* A UDP socket on any port of loopback, with the kernel's stamps. */
static int opened(void)
{
    int fd = socket(AF_INET, SOCK_DGRAM, 0), on = 1, room = 1 << 20;
    struct sockaddr_in a = at(0);
    bind(fd, (struct sockaddr *)&a, sizeof a);
    setsockopt(fd, SOL_SOCKET, SO_RCVBUF, &room, sizeof room);
    setsockopt(fd, SOL_SOCKET, SO_TIMESTAMPNS, &on, sizeof on);
    return fd;
}

static int port_of(int fd)
{
    struct sockaddr_in a;
    socklen_t size = sizeof a;
    getsockname(fd, (struct sockaddr *)&a, &size);
    return ntohs(a.sin_port);
}

/* A datagram that is there, where it came from and when (CLOCK_REALTIME); -1: none. */
static int taken(int fd, char *data, struct sockaddr_in *from, int64_t *came)
{
    char notes[64];
    struct iovec part = {data, LONGEST};
    struct msghdr message = {.msg_name = from, .msg_namelen = sizeof *from, .msg_iov = &part, .msg_iovlen = 1,
                             .msg_control = notes, .msg_controllen = sizeof notes};
    int size = recvmsg(fd, &message, MSG_DONTWAIT);
    if (size < 0)
        return -1;
    *came = now(CLOCK_REALTIME);
    for (struct cmsghdr *c = CMSG_FIRSTHDR(&message); c; c = CMSG_NXTHDR(&message, c))
        if (c->cmsg_level == SOL_SOCKET && c->cmsg_type == SO_TIMESTAMPNS) {
            struct timespec t;
            memcpy(&t, CMSG_DATA(c), sizeof t);
            *came = t.tv_sec * S + t.tv_nsec;
        }
    return size;
}

static int tick(int n, int priority)
{
    struct sched_param asked = {.sched_priority = priority};
    if (priority && sched_setscheduler(0, SCHED_FIFO, &asked))
        priority = 0;
    double *late = malloc(n * sizeof *late);
    int64_t start = now(CLOCK_MONOTONIC) + 20 * MS, k = -1;
    int timer = timerfd_create(CLOCK_MONOTONIC, 0);
    set(timer, start, MS);
    for (int i = 0; i < n;) {
        uint64_t rings;
        if (read(timer, &rings, sizeof rings) < 0)
            return 1;
        int64_t woken = now(CLOCK_MONOTONIC);
        for (; rings && i < n; rings--) /* those that were missed are late too */
            late[i++] = (woken - start - ++k * MS) * 1e-3;
    }
    struct rusage used;
    getrusage(RUSAGE_SELF, &used);
    double cpu = used.ru_utime.tv_sec + used.ru_stime.tv_sec + (used.ru_utime.tv_usec + used.ru_stime.tv_usec) * 1e-6;
    told(late, n);
    printf(" %.4f %.2f %d\n", cpu / (n * 1e-3), n ? late[n - 1] : 0.0, priority);  /* sorted by now */
    return 0;
}

_Noreturn static void echo(void)
{
    int fd = opened();
    char data[LONGEST];
    printf("%d\n", port_of(fd));
    fflush(stdout);
    for (;;) {
        struct sockaddr_in from;
        socklen_t size = sizeof from;
        int n = recvfrom(fd, data, sizeof data, 0, (struct sockaddr *)&from, &size);
        if (n >= 0)
            sendto(fd, data, n, 0, (struct sockaddr *)&from, size);
    }
}

static int ping(int port, int n)
{
    int fd = opened();
    char data[LONGEST] = {0};
    struct sockaddr_in peer = at(port);
    double *us = malloc(n * sizeof *us);
    connect(fd, (struct sockaddr *)&peer, sizeof peer);
    for (int i = 0; i < n; i++) {
        int64_t began = now(CLOCK_MONOTONIC);
        send(fd, data, 100, 0);
        if (recv(fd, data, sizeof data, 0) < 0)
            return 1;
        us[i] = (now(CLOCK_MONOTONIC) - began) * 1e-3;
    }
    told(us, n);
    puts("");
    return 0;
}

static int watching(const int *fds, int count)
{
    int poll = epoll_create1(0);
    for (int i = 0; i < count; i++) {
        struct epoll_event e = {.events = EPOLLIN, .data.u32 = i};
        epoll_ctl(poll, EPOLL_CTL_ADD, fds[i], &e);
    }
    return poll;
}

struct under_way { int64_t due; int size; char data[LONGEST]; };

_Noreturn static void relay(int peer_port, int64_t delay)
{
    int timer = timerfd_create(CLOCK_MONOTONIC, TFD_NONBLOCK), fds[3] = {opened(), opened(), timer};
    int poll = watching(fds, 3), known[2] = {0, 1};
    struct sockaddr_in peers[2] = {at(0), at(peer_port)};
    static struct under_way ring[2][DEEP];  /* one delay for all: first in, first out */
    unsigned first[2] = {0, 0}, next[2] = {0, 0};
    int64_t armed = 0;
    printf("%d\n", port_of(fds[0]));
    fflush(stdout);
    for (;;) {
        struct epoll_event events[3];
        int count = epoll_wait(poll, events, 3, -1);
        for (int i = 0; i < count; i++) {
            unsigned way = events[i].data.u32;
            uint64_t rings;
            if (way == 2) {
                if (read(timer, &rings, sizeof rings) > 0)
                    armed = 0;
                continue;
            }
            for (int j = 0; j < DRAIN && next[way] - first[way] < DEEP; j++) {
                struct under_way *one = &ring[way][next[way] % DEEP];
                struct sockaddr_in from;
                int64_t came;
                if ((one->size = taken(fds[way], one->data, &from, &came)) < 0)
                    break;
                if (!known[way])
                    peers[way] = from, known[way] = 1;
                one->due = now(CLOCK_MONOTONIC) - (now(CLOCK_REALTIME) - came) + delay;
                next[way]++;
            }
        }
        int64_t t = now(CLOCK_MONOTONIC), soon = 0;
        for (int way = 0; way < 2; way++) {
            for (; first[way] != next[way] && ring[way][first[way] % DEEP].due <= t; first[way]++) {
                struct under_way *one = &ring[way][first[way] % DEEP];
                sendto(fds[1 - way], one->data, one->size, 0, (struct sockaddr *)&peers[1 - way], sizeof peers[0]);
            }
            if (first[way] != next[way] && (!soon || ring[way][first[way] % DEEP].due < soon))
                soon = ring[way][first[way] % DEEP].due;
        }
        if (soon && soon != armed)
            set(timer, armed = soon, 0);
    }
}

struct datagrams { int count; char **data; int *size; int64_t *sent; int64_t *came; int newest; };

static struct datagrams read_in(const char *path, int count)
{
    struct datagrams d = {.data = calloc(count + 1, sizeof *d.data), .size = calloc(count + 1, sizeof *d.size),
                          .sent = calloc(count + 1, sizeof *d.sent), .came = calloc(count + 1, sizeof *d.came)};
    FILE *file = fopen(path, "rb");
    unsigned char length[2];
    while (file && d.count <= count && fread(length, 2, 1, file) == 1) {
        int size = d.size[d.count] = length[0] + 256 * length[1];
        d.data[d.count] = malloc(size);
        if (fread(d.data[d.count], size, 1, file) != 1)
            break;
        d.count++;
    }
    if (d.count != count + 1)
        exit(1);
    return d;
}

/* Note when a datagram came; they mostly come in the order in which they went. */
static void noted(struct datagrams *d, const char *data, int size, int64_t came)
{
    for (int i = 1; i < d->count; i++) {
        int k = 1 + (d->newest + i - 1) % (d->count - 1);
        if (d->size[k] == size && !memcmp(d->data[k], data, size)) {
            d->came[k] = d->came[k] ? d->came[k] : came;
            d->newest = k;
            return;
        }
    }
}

static int load(const char *forth, const char *back, int64_t rate, int count, int64_t delay)
{
    struct datagrams d[2] = {read_in(forth, count), read_in(back, count)};
    int timer = timerfd_create(CLOCK_MONOTONIC, TFD_NONBLOCK), fds[3] = {opened(), opened(), timer}, port;
    int poll = watching(fds, 3), sent = 0, quiet = 0;
    char data[LONGEST];
    struct timeval patience = {10, 0};
    printf("%d\n", port_of(fds[1]));
    fflush(stdout);
    if (scanf("%d", &port) != 1)
        return 1;
    struct sockaddr_in towards[2] = {at(port), at(0)}, from;
    socklen_t size = sizeof from;
    for (int way = 0; way < 2; way++) {  /* the session begins: there, then back */
        setsockopt(fds[1 - way], SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
        sendto(fds[way], d[way].data[0], d[way].size[0], 0, (struct sockaddr *)&towards[way], sizeof from);
        if (recvfrom(fds[1 - way], data, sizeof data, 0, (struct sockaddr *)(way ? &from : &towards[1]), &size) < 0)
            return 1;
    }
    set(timer, now(CLOCK_MONOTONIC) + 20 * MS, S / rate);
    while (quiet < 10) {  /* until a second after the last */
        struct epoll_event events[3];
        int ready = epoll_wait(poll, events, 3, 100);
        quiet = ready ? 0 : quiet + 1;
        for (int i = 0; i < ready; i++) {
            unsigned way = events[i].data.u32;
            uint64_t rings;
            int64_t came;
            if (way < 2) {
                for (int n; (n = taken(fds[way], data, &from, &came)) >= 0;)
                    noted(&d[1 - way], data, n, came);
            } else if (read(timer, &rings, sizeof rings) > 0) {
                for (; rings && sent < count; rings--) {
                    sent++;
                    for (int w = 0; w < 2; w++) {
                        d[w].sent[sent] = now(CLOCK_REALTIME);
                        sendto(fds[w], d[w].data[sent], d[w].size[sent], 0, (struct sockaddr *)&towards[w], sizeof from);
                    }
                }
                if (sent == count)
                    set(timer, 0, 0);
            }
        }
    }
    double *error = malloc(2 * count * sizeof *error);
    int lost[2] = {0, 0}, arrived = 0;
    for (int w = 0; w < 2; w++)
        for (int k = 1; k <= count; k++) {
            int64_t off = d[w].came[k] - d[w].sent[k] - delay;
            if (!d[w].came[k])
                lost[w]++;
            else
                error[arrived++] = (off < 0 ? -off : off) * 1e-3;
        }
    printf("%d %d ", lost[0], lost[1]);
    told(error, arrived);
    puts("");
    return 0;
}

int main(int count, char **word)
{
    const char *what = count > 1 ? word[1] : "";
    if (!strcmp(what, "tick") && (count == 3 || count == 4))
        return tick(atoi(word[2]), count == 4 ? atoi(word[3]) : 0);
    if (!strcmp(what, "echo") && count == 2)
        echo();
    if (!strcmp(what, "ping") && count == 4)
        return ping(atoi(word[2]), atoi(word[3]));
    if (!strcmp(what, "relay") && count == 4)
        relay(atoi(word[2]), atoll(word[3]));
    if (!strcmp(what, "load") && count == 7)
        return load(word[2], word[3], atoll(word[4]), atoi(word[5]), atoll(word[6]));
    return 2;
}
