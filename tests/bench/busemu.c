/* A servo bus on a pseudo-terminal, and the bare client that is the floor of every measurement.
 *
 *   busemu serve [--ids 1-7] [--baud N] [--fault drop|flip|junk|short:RATE] [--mute ID] [--echo AFTER]
 *                [--seed N] [--cpu N]
 *   busemu client PATH read|sync_read|sync_write|cycle COUNT [--ids 1-7] [--cpu N]
 *
 * `serve` prints the path of its terminal and runs until its standard input closes. Servos are STS: position and
 * goal are the same register pair, so a position read tells which goal landed. Baud 0 costs no time; any other
 * rate delivers each packet when its last bit would have come over the line (10 bits a byte). AFTER requests pass
 * before the adapter starts to echo. `client` prints p50, p99 and mean wall time and the CPU time of a call, all in
 * microseconds, then calls a second.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <pty.h>
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

enum { PING = 1, READ = 2, WRITE = 3, SYNC_READ = 0x82, SYNC_WRITE = 0x83, ALL = 0xFE };
enum fault { NONE, DROP, FLIP, JUNK, SHORT };

static uint8_t regs[254][256];
static int present[254], first_id = 1, last_id = 7, mute = -1, line;
static long baud, echo_after = -1, requests;
static enum fault fault;
static double fault_rate;
static uint64_t seed = 1;
static double line_time; /* when the wire is free again */

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec + t.tv_nsec * 1e-9;
}

static double chance(void)
{
    seed ^= seed << 13;
    seed ^= seed >> 7;
    seed ^= seed << 17;
    return (seed >> 11) / 9007199254740992.0;
}

static void sleep_until(double when)
{
    struct timespec t = {(time_t)when, (long)((when - (time_t)when) * 1e9)};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL) == EINTR) {
    }
}

static void put(const uint8_t *data, int n)
{
    while (n > 0) {
        ssize_t sent = write(line, data, n);
        if (sent < 0 && errno != EINTR && errno != EAGAIN)
            exit(0);
        if (sent > 0) {
            data += sent;
            n -= sent;
        }
    }
}

/* Bytes cross the wire, then arrive in one piece. Without a line rate they are gathered, and `flush_out` sends them. */
static uint8_t gathered[65536];
static int gathered_n;

static void flush_out(void)
{
    put(gathered, gathered_n);
    gathered_n = 0;
}

static void deliver(const uint8_t *data, int n)
{
    if (!baud) {
        memcpy(gathered + gathered_n, data, n);
        gathered_n += n;
        return;
    }
    line_time += n * 10.0 / baud;
    if (line_time > now())
        sleep_until(line_time);
    put(data, n);
}

static void answer(int id, const uint8_t *params, int n)
{
    uint8_t p[300];
    int sum = id + n + 2, size = n + 6;
    if (id == mute)
        return;
    p[0] = p[1] = 0xFF;
    p[2] = id;
    p[3] = n + 2;
    p[4] = 0;
    for (int i = 0; i < n; i++)
        sum += p[5 + i] = params[i];
    p[5 + n] = ~sum;
    if (fault != NONE && chance() < fault_rate) {
        uint8_t junk[5];
        if (fault == DROP)
            return;
        if (fault == FLIP)
            p[(int)(chance() * size)] ^= 1 << (int)(chance() * 8);
        if (fault == SHORT)
            size = 1 + (int)(chance() * (size - 1));
        if (fault == JUNK) {
            int count = 1 + (int)(chance() * 5);
            for (int i = 0; i < count; i++)
                junk[i] = chance() * 256;
            deliver(junk, count);
        }
    }
    deliver(p, size);
}

static void handle(const uint8_t *p, int size)
{
    int id = p[2], inst = p[4], n = p[3] - 2;
    const uint8_t *params = p + 5;
    requests++;
    if (baud) {
        double t = now();
        line_time = (line_time > t ? line_time : t) + size * 10.0 / baud;
    }
    if (echo_after >= 0 && requests > echo_after) {
        if (baud)
            line_time -= size * 10.0 / baud; /* the echo arrives while it is sent */
        deliver(p, size);
    }
    if (inst == SYNC_READ && id == ALL)
        for (int i = 2; i < n; i++) {
            if (params[i] < 254 && present[params[i]])
                answer(params[i], regs[params[i]] + params[0], params[1]);
        }
    else if (inst == SYNC_WRITE && id == ALL)
        for (int i = 2; i + params[1] < n; i += params[1] + 1) {
            if (params[i] < 254 && present[params[i]]) {
                memcpy(regs[params[i]] + params[0], params + i + 1, params[1]);
                if (params[0] == 42)
                    memcpy(regs[params[i]] + 56, params + i + 1, 2);
            }
        }
    else if (id < 254 && present[id]) {
        if (inst == PING)
            answer(id, NULL, 0);
        else if (inst == READ && n == 2 && params[0] + params[1] <= 256)
            answer(id, regs[id] + params[0], params[1]);
        else if (inst == WRITE && n > 1) {
            memcpy(regs[id] + params[0], params + 1, n - 1);
            if (params[0] == 42)
                memcpy(regs[id] + 56, params + 1, 2);
            answer(id, NULL, 0);
        }
    }
    flush_out();
}

static void raw(int fd)
{
    struct termios t;
    tcgetattr(fd, &t);
    cfmakeraw(&t);
    tcsetattr(fd, TCSANOW, &t);
}

static int serve(void)
{
    char path[128];
    uint8_t buf[8192];
    int slave, have = 0;
    if (openpty(&line, &slave, path, NULL, NULL))
        return perror("openpty"), 1;
    raw(slave);
    for (int id = first_id; id <= last_id; id++) {
        int position = 1000 + 100 * id;
        present[id] = 1;
        regs[id][0] = 3; /* firmware 3.10, model 777: STS3215 */
        regs[id][1] = 10;
        regs[id][3] = 9;
        regs[id][4] = 3;
        regs[id][5] = id;
        regs[id][8] = 1;
        regs[id][11] = 0xFF;
        regs[id][12] = 0x0F;
        regs[id][42] = regs[id][56] = position & 0xFF;
        regs[id][43] = regs[id][57] = position >> 8;
        regs[id][62] = 74;
        regs[id][63] = 31;
    }
    prctl(PR_SET_TIMERSLACK, 1);
    printf("%s\n", path);
    fflush(stdout);
    for (;;) {
        struct pollfd watched[2] = {{line, POLLIN, 0}, {0, POLLIN, 0}};
        if (poll(watched, 2, -1) < 0 && errno != EINTR)
            return 1;
        if (watched[1].revents) {
            char c;
            if (read(0, &c, 1) <= 0)
                return 0;
        }
        if (!watched[0].revents)
            continue;
        ssize_t got = read(line, buf + have, sizeof buf - have);
        if (got <= 0)
            continue;
        have += got;
        int at = 0;
        while (have - at >= 6) {
            int size = buf[at + 3] + 4, sum = 0;
            if (buf[at] != 0xFF || buf[at + 1] != 0xFF || buf[at + 2] == 0xFF || size < 6) {
                at++;
                continue;
            }
            if (have - at < size)
                break;
            for (int i = 2; i < size; i++)
                sum += buf[at + i];
            if ((sum & 0xFF) != 0xFF) {
                at++;
                continue;
            }
            handle(buf + at, size);
            at += size;
        }
        memmove(buf, buf + at, have -= at);
        if (have == sizeof buf)
            have = 0;
    }
}

/* --- the floor: write, then read until the answer is whole ------------------------------------------------------ */

static int make(uint8_t *p, int id, int inst, const uint8_t *params, int n)
{
    int sum = id + n + 2 + inst;
    p[0] = p[1] = 0xFF;
    p[2] = id;
    p[3] = n + 2;
    p[4] = inst;
    for (int i = 0; i < n; i++)
        sum += p[5 + i] = params[i];
    p[5 + n] = ~sum;
    return n + 6;
}

static void ask(int fd, const uint8_t *packet, int size, int want)
{
    uint8_t buf[512];
    int got = 0;
    if (write(fd, packet, size) != size)
        exit(1);
    while (got < want) {
        ssize_t n = read(fd, buf + got, sizeof buf - got);
        if (n <= 0)
            exit(1);
        got += n;
    }
    for (int at = 0; at < want; at += 8) {
        int sum = 0;
        for (int i = 2; i < 8; i++)
            sum += buf[at + i];
        if ((sum & 0xFF) != 0xFF)
            exit(2);
    }
}

static int by_value(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static int client(const char *path, const char *op, long count)
{
    uint8_t single[16], sync[64], write7[128], params[64];
    uint8_t read_params[2] = {56, 2};
    int fd = open(path, O_RDWR | O_NOCTTY), n = last_id - first_id + 1;
    if (fd < 0)
        return perror(path), 1;
    raw(fd);
    int single_n = make(single, first_id, READ, read_params, 2);
    params[0] = 56;
    params[1] = 2;
    for (int i = 0; i < n; i++)
        params[2 + i] = first_id + i;
    int sync_n = make(sync, ALL, SYNC_READ, params, n + 2);
    params[0] = 42;
    for (int i = 0; i < n; i++) {
        params[2 + 3 * i] = first_id + i;
        params[3 + 3 * i] = 0x00;
        params[4 + 3 * i] = 0x08;
    }
    int write7_n = make(write7, ALL, SYNC_WRITE, params, 3 * n + 2);
    int reads = !strcmp(op, "sync_read") || !strcmp(op, "cycle");
    int writes = !strcmp(op, "sync_write") || !strcmp(op, "cycle");
    double *took = malloc(sizeof *took * count), total, cpu;
    struct rusage before, after;
    getrusage(RUSAGE_SELF, &before);
    double start = now();
    for (long i = 0; i < count; i++) {
        double t = now();
        if (writes)
            ask(fd, write7, write7_n, 0);
        if (reads)
            ask(fd, sync, sync_n, 8 * n);
        else if (!writes)
            ask(fd, single, single_n, 8);
        took[i] = now() - t;
    }
    total = now() - start;
    getrusage(RUSAGE_SELF, &after);
    cpu = (after.ru_utime.tv_sec - before.ru_utime.tv_sec) + (after.ru_stime.tv_sec - before.ru_stime.tv_sec) +
          ((after.ru_utime.tv_usec - before.ru_utime.tv_usec) + (after.ru_stime.tv_usec - before.ru_stime.tv_usec)) *
              1e-6;
    qsort(took, count, sizeof *took, by_value);
    printf("%.3f %.3f %.3f %.3f %.1f\n", took[count / 2] * 1e6, took[count * 99 / 100] * 1e6, total / count * 1e6,
           cpu / count * 1e6, count / total);
    return 0;
}

static const char *option(int argc, char **argv, const char *name, const char *fallback)
{
    for (int i = 1; i + 1 < argc; i++)
        if (!strcmp(argv[i], name))
            return argv[i + 1];
    return fallback;
}

int main(int argc, char **argv)
{
    const char *ids = option(argc, argv, "--ids", "1-7"), *cpu = option(argc, argv, "--cpu", NULL);
    const char *kind = option(argc, argv, "--fault", NULL);
    if (sscanf(ids, "%d-%d", &first_id, &last_id) != 2 || first_id < 0 || last_id > 253)
        return fprintf(stderr, "--ids wants FIRST-LAST\n"), 2;
    if (cpu) {
        cpu_set_t set;
        CPU_ZERO(&set);
        CPU_SET(atoi(cpu), &set);
        sched_setaffinity(0, sizeof set, &set);
    }
    baud = atol(option(argc, argv, "--baud", "0"));
    mute = atoi(option(argc, argv, "--mute", "-1"));
    echo_after = atol(option(argc, argv, "--echo", "-1"));
    seed = strtoull(option(argc, argv, "--seed", "88172645463325252"), NULL, 0);
    if (kind) {
        static const char *names[] = {"none", "drop", "flip", "junk", "short"};
        for (int i = DROP; i <= SHORT; i++)
            if (!strncmp(kind, names[i], strlen(names[i])))
                fault = i;
        const char *rate = strchr(kind, ':');
        if (fault == NONE || !rate)
            return fprintf(stderr, "--fault wants drop|flip|junk|short:RATE\n"), 2;
        fault_rate = atof(rate + 1);
    }
    if (argc > 1 && !strcmp(argv[1], "serve"))
        return serve();
    if (argc > 4 && !strcmp(argv[1], "client"))
        return client(argv[2], argv[3], atol(argv[4]));
    return fprintf(stderr, "busemu serve|client ...\n"), 2;
}
