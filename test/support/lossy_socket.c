/* A lossy network for one process: preloaded, it loses LOSS percent of the datagrams that come.
 *
 * What is lost is taken from the socket, and the caller told that nothing was there.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <stdlib.h>
#include <sys/socket.h>

static int is_lost(int socket) {
    static unsigned state = 1;
    int kind = 0;
    socklen_t size = sizeof kind;
    const char *loss = getenv("LOSS");
    if (!loss || getsockopt(socket, SOL_SOCKET, SO_TYPE, &kind, &size) || kind != SOCK_DGRAM)
        return 0;
    /* Threads that race for the state only make it more random. */
    return rand_r(&state) % 100 < atoi(loss);
}

ssize_t recvmsg(int socket, struct msghdr *message, int flags) {
    static ssize_t (*real)(int, struct msghdr *, int);
    if (!real)
        real = dlsym(RTLD_NEXT, "recvmsg");
    ssize_t got = real(socket, message, flags);
    if (got > 0 && !(flags & MSG_PEEK) && is_lost(socket)) {
        errno = EAGAIN;
        return -1;
    }
    return got;
}

ssize_t recvfrom(int socket, void *data, size_t room, int flags, struct sockaddr *from,
                 socklen_t *from_size) {
    static ssize_t (*real)(int, void *, size_t, int, struct sockaddr *, socklen_t *);
    if (!real)
        real = dlsym(RTLD_NEXT, "recvfrom");
    ssize_t got = real(socket, data, room, flags, from, from_size);
    if (got > 0 && !(flags & MSG_PEEK) && is_lost(socket)) {
        errno = EAGAIN;
        return -1;
    }
    return got;
}
