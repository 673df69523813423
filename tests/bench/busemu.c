/* A servo bus on a pseudo-terminal, and the bare client that is the floor of every measurement.
 *
 *   busemu serve [--ids 1-7] [--baud N] [--fault drop|flip|junk|short:RATE] [--mute ID] [--echo AFTER]
 *                [--seed N] [--cpu N]
 *   busemu pair [--baud N] [--fault drop|flip|junk|short:RATE] [--seed N]
 *   busemu client PATH read|sync_read|sync_write|cycle COUNT [--ids 1-7] [--cpu N]
 *
 * `serve` prints the path of its terminal and runs until its standard input closes. Servos are STS: position and
 * goal are the same register pair, so a position read tells which goal landed. Baud 0 costs no time; any other
 * rate delivers each packet when its last bit would have come over the line (10 bits a byte). AFTER requests pass
 * before the adapter starts to echo.
 *
 * `pair` serves two lines with servos 1 to 6: a leader whose joints go up and down in small steps, and a follower
 * whose goals it records. It prints both paths, leader first. Lines on its standard input: "begin", or "faults" for
 * one with faults, begins a recording and prints the time; "end" ends it, and prints the number of goals, the time of
 * step 0, seconds between steps, counts of a step, and steps from the lowest count to the highest; then a line for
 * each goal: the time at which its last byte had come over the line, and the counts of the servos. At step 0 the
 * leader is at the lowest count, 2048 less half of the steps. Times are seconds of CLOCK_MONOTONIC.
 *
 * `client` prints p50, p99 and mean wall time and the CPU time of a call, all in
 * microseconds, then calls a second.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <pthread.h>
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

enum { MIDDLE = 2048, STEP = 4, STEPS = 128, JOINTS = 6, MOST_GOALS = 200000 };
#define STEP_TIME 0.02371 /* no multiple of anybody's period */

static int first_id = 1, last_id = 7, mute = -1;
static long baud, echo_after = -1;
static enum fault fault;
static double fault_rate;
static volatile int faulty = 1;
static uint64_t first_seed = 1;

/* Of one line; each has a thread. */
static _Thread_local uint8_t regs[254][256];
static _Thread_local int present[254], line, leads, follows;
static _Thread_local long requests;
static _Thread_local uint64_t seed;
static _Thread_local double line_time; /* when the wire is free again */

/* Of the follower's goals. */
static struct goal {
    double when;
    int counts[JOINTS];
} goals[MOST_GOALS];
static volatile int recording, goals_n;
static double origin;

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
static _Thread_local uint8_t gathered[65536];
static _Thread_local int gathered_n;

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

static int led(double when)
{
    int at = (long)((when - origin) / STEP_TIME) % (2 * STEPS);
    return MIDDLE + STEP * ((at < STEPS ? at : 2 * STEPS - at) - STEPS / 2);
}

static void record(double when)
{
    if (!recording || goals_n == MOST_GOALS)
        return;
    goals[goals_n].when = when;
    for (int i = 0; i < JOINTS; i++)
        goals[goals_n].counts[i] = regs[1 + i][42] | regs[1 + i][43] << 8;
    goals_n++;
}

/* Without inertia: a servo is where its goal is. */
static void written(int id, int address, int n)
{
    if (address <= 42 && address + n >= 44)
        memcpy(regs[id] + 56, regs[id] + 42, 2);
}

static void answer(int id, const uint8_t *params, int n)
{
    uint8_t p[300];
    int sum = id + n + 2, size = n + 6;
    if (id == mute)
        return;
    if (leads) {
        /* It samples when it answers. */
        double t = now();
        int counts = led(line_time > t ? line_time : t);
        regs[id][56] = counts & 0xFF;
        regs[id][57] = counts >> 8;
    }
    p[0] = p[1] = 0xFF;
    p[2] = id;
    p[3] = n + 2;
    p[4] = 0;
    for (int i = 0; i < n; i++)
        sum += p[5 + i] = params[i];
    p[5 + n] = ~sum;
    if (fault != NONE && faulty && chance() < fault_rate) {
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
                written(params[i], params[0], params[1]);
            }
        }
    else if (inst == WRITE && id == ALL && n > 1) {
        for (int i = first_id; i <= last_id; i++) {
            memcpy(regs[i] + params[0], params + 1, n - 1);
            written(i, params[0], n - 1);
        }
    } else if (id < 254 && present[id]) {
        if (inst == PING)
            answer(id, NULL, 0);
        else if (inst == READ && n == 2 && params[0] + params[1] <= 256)
            answer(id, regs[id] + params[0], params[1]);
        else if (inst == WRITE && n > 1) {
            memcpy(regs[id] + params[0], params + 1, n - 1);
            written(id, params[0], n - 1);
            answer(id, NULL, 0);
        }
    }
    if (follows && inst == SYNC_WRITE && params[0] <= 42 && params[0] + params[1] >= 44)
        record(baud ? line_time : now());
    flush_out();
}

static void raw(int fd)
{
    struct termios t;
    tcgetattr(fd, &t);
    cfmakeraw(&t);
    tcsetattr(fd, TCSANOW, &t);
}

/* Opens a terminal, keeps its other end open, and makes its servos. */
static int open_line(char *path)
{
    int slave;
    if (openpty(&line, &slave, path, NULL, NULL))
        return perror("openpty"), 1;
    raw(slave);
    seed = first_seed;
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
    return 0;
}

static int run_line(int until_eof)
{
    uint8_t buf[8192];
    int have = 0;
    prctl(PR_SET_TIMERSLACK, 1);
    for (;;) {
        struct pollfd watched[2] = {{line, POLLIN, 0}, {0, POLLIN, 0}};
        if (poll(watched, until_eof ? 2 : 1, -1) < 0 && errno != EINTR)
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

static int serve(void)
{
    char path[128];
    if (open_line(path))
        return 1;
    printf("%s\n", path);
    fflush(stdout);
    return run_line(1);
}

static char pair_paths[2][128];
static volatile int pair_ready;

static void *run_one(void *which)
{
    int i = *(int *)which;
    if (open_line(pair_paths[i]))
        exit(1);
    seed += 0x9E3779B97F4A7C15u * i;
    leads = !i;
    follows = i;
    for (int id = first_id; id <= last_id; id++) {
        regs[id][42] = regs[id][56] = MIDDLE & 0xFF;
        regs[id][43] = regs[id][57] = MIDDLE >> 8;
        /* The upper arm is raised by 45 degrees, so that no joint comes near the table. */
        int middle = MIDDLE + (id == 2 ? 512 : 0);
        regs[id][9] = (middle - 1000) & 0xFF;
        regs[id][10] = (middle - 1000) >> 8;
        regs[id][11] = (middle + 1000) & 0xFF;
        regs[id][12] = (middle + 1000) >> 8;
    }
    __sync_fetch_and_add(&pair_ready, 1);
    exit(run_line(0));
}

static int pair(void)
{
    static int numbers[2] = {0, 1};
    pthread_t threads[2];
    char words[64];
    first_id = 1;
    last_id = JOINTS;
    faulty = 0;
    origin = now();
    for (int i = 0; i < 2; i++)
        if (pthread_create(&threads[i], NULL, run_one, &numbers[i]))
            return perror("pthread_create"), 1;
    while (pair_ready < 2)
        usleep(1000);
    printf("%s %s\n", pair_paths[0], pair_paths[1]);
    fflush(stdout);
    while (fgets(words, sizeof words, stdin)) {
        if (!strcmp(words, "end\n")) {
            recording = faulty = 0;
            usleep(20000);
            printf("%d %.9f %.9f %d %d\n", goals_n, origin, STEP_TIME, STEP, STEPS);
            for (int i = 0; i < goals_n; i++) {
                printf("%.9f", goals[i].when);
                for (int j = 0; j < JOINTS; j++)
                    printf(" %d", goals[i].counts[j]);
                printf("\n");
            }
        } else {
            goals_n = 0;
            faulty = !strcmp(words, "faults\n");
            recording = 1;
            printf("%.9f\n", now());
        }
        fflush(stdout);
    }
    return 0;
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
    first_seed = strtoull(option(argc, argv, "--seed", "88172645463325252"), NULL, 0);
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
    if (argc > 1 && !strcmp(argv[1], "pair"))
        return pair();
    if (argc > 4 && !strcmp(argv[1], "client"))
        return client(argv[2], argv[3], atol(argv[4]));
    return fprintf(stderr, "busemu serve|pair|client ...\n"), 2;
}
