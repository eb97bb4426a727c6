/*
 * A clock that the simulation owns, put under a program that was never told of one: preloaded into Betaflight's SITL.
 *
 * Time in the program's main thread goes on by what it sleeps, and by HEXJET_TICK_NS with every look at the clock, as if
 * that were what its work costs; nothing else moves it.  It stops at a limit, and each state packet that the program has
 * taken in moves that limit on by HEXJET_STEP_NS.  So a packet is taken in while the main thread stands still, the main
 * thread then lives through exactly one step, and what it computes follows no clock of the machine.  Before the first
 * packet it may live through HEXJET_BOOT_NS; when it has, eight bytes "HJREADY" go to the port of the raw outputs.
 *
 * The program's threads begin when its main thread has opened its ports: its console's thread throws away whatever port it
 * finds made and not yet open, so that on a busy machine nobody answers there.
 *
 * Without HEXJET_STEP_NS the clock is the machine's.  HEXJET_PORT moves the program's ports: 9001 to 9004 become that and
 * the next three, 5761 to 5768 those from the tenth behind it on, so that several can fly at the same time.
 */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <dlfcn.h>
#include <errno.h>
#include <netinet/in.h>
#include <pthread.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <time.h>

enum { RAW = 9001, STATE = 9003, RC = 9004, CONSOLE = 5761, CONSOLES = 8 };

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static pthread_cond_t changed = PTHREAD_COND_INITIALIZER;
static pthread_t main_thread;
static uint64_t now_ns, limit_ns, step_ns, tick_ns;
static unsigned states, sticks; /* packets taken in, and all done that their threads do with them */
static int standing, told, taken, held; /* main thread stands at the limit; the start was told; a state, sticks are being taken in */
static int bound, opened; /* the console's port has been bound; the main thread has gone on from there */
static int port_base, state_socket = -1, rc_socket = -1;

static int (*real_clock_gettime)(clockid_t, struct timespec *);
static int (*real_nanosleep)(const struct timespec *, struct timespec *);
static int (*real_pthread_create)(pthread_t *, const pthread_attr_t *, void *(*)(void *), void *);
static int (*real_bind)(int, const struct sockaddr *, socklen_t);
static int (*real_select)(int, fd_set *, fd_set *, fd_set *, struct timeval *);
static ssize_t (*real_sendto)(int, const void *, size_t, int, const struct sockaddr *, socklen_t);
static ssize_t (*real_recvfrom)(int, void *, size_t, int, struct sockaddr *, socklen_t *);

static uint64_t number(const char *name, uint64_t otherwise)
{
    const char *text = getenv(name);
    return text ? strtoull(text, NULL, 10) : otherwise;
}

__attribute__((constructor)) static void begin(void)
{
    main_thread = pthread_self();
    real_clock_gettime = dlsym(RTLD_NEXT, "clock_gettime");
    real_nanosleep = dlsym(RTLD_NEXT, "nanosleep");
    real_pthread_create = dlsym(RTLD_NEXT, "pthread_create");
    real_bind = dlsym(RTLD_NEXT, "bind");
    real_select = dlsym(RTLD_NEXT, "select");
    real_sendto = dlsym(RTLD_NEXT, "sendto");
    real_recvfrom = dlsym(RTLD_NEXT, "recvfrom");
    step_ns = number("HEXJET_STEP_NS", 0);
    tick_ns = number("HEXJET_TICK_NS", 1000);
    limit_ns = number("HEXJET_BOOT_NS", 2000000000);
    port_base = (int)number("HEXJET_PORT", 0);
    setvbuf(stdout, NULL, _IOLBF, 0); /* what it printed before it was killed is in its log */
    now_ns = 1; /* the program divides by differences of times */
}

static int moved(int port)
{
    if (!port_base)
        return port;
    if (port >= RAW && port <= RC)
        return port_base + port - RAW;
    if (port >= CONSOLE && port < CONSOLE + CONSOLES)
        return port_base + 10 + port - CONSOLE;
    return port;
}

static void tell(void)
{
    struct sockaddr_in to = {.sin_family = AF_INET, .sin_port = htons((uint16_t)port_base)};
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    int out = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    real_sendto(out, "HJREADY", 8, 0, (struct sockaddr *)&to, sizeof to);
}

struct thread {
    void *(*run)(void *);
    void *argument;
};

static void *begin_late(void *given)
{
    const struct thread thread = *(struct thread *)given;
    free(given);
    pthread_mutex_lock(&lock);
    while (!opened)
        pthread_cond_wait(&changed, &lock);
    pthread_mutex_unlock(&lock);
    return thread.run(thread.argument);
}

int pthread_create(pthread_t *made, const pthread_attr_t *attributes, void *(*run)(void *), void *argument)
{
    struct thread *thread = malloc(sizeof *thread);
    if (!thread)
        return EAGAIN;
    *thread = (struct thread){run, argument};
    return real_pthread_create(made, attributes, begin_late, thread);
}

/* The main thread looks at the clock, or stands: what it was opening is open. */
static void open_up(void)
{
    pthread_mutex_lock(&lock);
    opened = 1;
    pthread_cond_broadcast(&changed);
    pthread_mutex_unlock(&lock);
}

/* The main thread lives on by so much; it stands at the limit until that has moved. */
static void live(uint64_t ns)
{
    pthread_mutex_lock(&lock);
    const uint64_t wanted = now_ns + ns;
    while (wanted > limit_ns) {
        now_ns = limit_ns;
        standing = opened = 1;
        if (!told) {
            told = 1;
            tell();
        }
        pthread_cond_broadcast(&changed);
        pthread_cond_wait(&changed, &lock);
    }
    standing = 0;
    now_ns = wanted;
    pthread_mutex_unlock(&lock);
}

static int owned(void) { return step_ns && pthread_equal(pthread_self(), main_thread); }

int clock_gettime(clockid_t clock, struct timespec *at)
{
    if (bound && !opened && pthread_equal(pthread_self(), main_thread))
        open_up();
    if (!step_ns || clock != CLOCK_MONOTONIC)
        return real_clock_gettime(clock, at);
    if (owned())
        live(tick_ns);
    pthread_mutex_lock(&lock);
    at->tv_sec = (time_t)(now_ns / 1000000000);
    at->tv_nsec = (long)(now_ns % 1000000000);
    pthread_mutex_unlock(&lock);
    return 0;
}

int nanosleep(const struct timespec *asked, struct timespec *left)
{
    if (!owned())
        return real_nanosleep(asked, left);
    live((uint64_t)asked->tv_sec * 1000000000 + (uint64_t)asked->tv_nsec);
    return 0;
}

int bind(int fd, const struct sockaddr *address, socklen_t size)
{
    struct sockaddr_storage there;
    in_port_t *port = NULL;
    memset(&there, 0, sizeof there);
    memcpy(&there, address, size < sizeof there ? size : sizeof there);
    if (there.ss_family == AF_INET)
        port = &((struct sockaddr_in *)&there)->sin_port;
    else if (there.ss_family == AF_INET6)
        port = &((struct sockaddr_in6 *)&there)->sin6_port;
    if (port) {
        const int stated = ntohs(*port);
        *port = htons((uint16_t)moved(stated));
        if (stated == STATE)
            state_socket = fd;
        if (stated == RC)
            rc_socket = fd;
        bound |= stated >= CONSOLE && stated < CONSOLE + CONSOLES;
        if (moved(stated) != stated || stated == STATE || stated == RC) {
            const int yes = 1; /* a console that was closed a moment ago keeps its port for a minute else */
            setsockopt(fd, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes);
            if (there.ss_family == AF_INET) /* of this machine alone */
                ((struct sockaddr_in *)&there)->sin_addr.s_addr = htonl(INADDR_LOOPBACK);
        }
    }
    return real_bind(fd, (struct sockaddr *)&there, size);
}

ssize_t sendto(int fd, const void *data, size_t size, int flags, const struct sockaddr *address, socklen_t length)
{
    if (!address || address->sa_family != AF_INET)
        return real_sendto(fd, data, size, flags, address, length);
    struct sockaddr_in there = *(const struct sockaddr_in *)address;
    there.sin_port = htons((uint16_t)moved(ntohs(there.sin_port)));
    return real_sendto(fd, data, size, flags, (struct sockaddr *)&there, sizeof there);
}

ssize_t recvfrom(int fd, void *data, size_t size, int flags, struct sockaddr *from, socklen_t *length)
{
    const int ours = step_ns && (fd == rc_socket || fd == state_socket);
    if (ours) { /* what the main thread reads does not change while it lives */
        pthread_mutex_lock(&lock);
        while (!standing || (fd == rc_socket && sticks > states)) /* the sticks of one step, not of the next */
            pthread_cond_wait(&changed, &lock);
        pthread_mutex_unlock(&lock);
    }
    const ssize_t got = real_recvfrom(fd, data, size, flags, from, length);
    if (!ours || got <= 0)
        return got;
    pthread_mutex_lock(&lock);
    if (fd == rc_socket)
        held = 1;
    else
        taken = 1;
    pthread_cond_broadcast(&changed);
    pthread_mutex_unlock(&lock);
    return got;
}

/*
 * A thread that takes in packets asks for the next: the one before is taken in, and its step may be lived.  With the first
 * sticks the program sets its receiver up, so they count when that is done and not when they have come: else the main
 * thread would meet the receiver in one look or in the next, as the machine has it, and its tasks another order for good.
 */
int select(int count, fd_set *in, fd_set *out, fd_set *bad, struct timeval *limit)
{
    if (step_ns && in && rc_socket >= 0 && rc_socket < count && FD_ISSET(rc_socket, in)) {
        pthread_mutex_lock(&lock);
        sticks += (unsigned)held;
        held = 0;
        pthread_cond_broadcast(&changed);
        pthread_mutex_unlock(&lock);
    }
    if (step_ns && in && state_socket >= 0 && state_socket < count && FD_ISSET(state_socket, in)) {
        pthread_mutex_lock(&lock);
        if (taken) {
            taken = 0;
            states++;
            while (sticks < states) /* the sticks of that step were sent before it */
                pthread_cond_wait(&changed, &lock);
            standing = 0;
            limit_ns += step_ns;
            pthread_cond_broadcast(&changed);
        }
        pthread_mutex_unlock(&lock);
    }
    return real_select(count, in, out, bad, limit);
}
