/* Stands between a process and the file system: the n-th call that changes what is below a folder fails, or kills.
 *
 * Loaded with LD_PRELOAD. FAULT_UNDER is the folder. `fault_arm` says which call of those to come is meant, and what
 * becomes of it: an errno, or -1 for SIGKILL before it is made. Every such call is written to the descriptor
 * FAULT_LOG as "name path", so that their order can be told. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

static long armed_at, calls;
static int fault, log_fd = -1;
static char under[4096];

void fault_arm(const char *folder, long at, int what, int fd) {
    strncpy(under, folder, sizeof under - 1);
    armed_at = at, fault = what, log_fd = fd, calls = 0;
}

long fault_calls(void) { return calls; }

static int below(const char *path) { return under[0] && path && strncmp(path, under, strlen(under)) == 0; }

/* Whether the call may be made; errno is set if not. */
static int allowed(const char *name, const char *path) {
    static ssize_t (*write_it)(int, const void *, size_t);
    if (!below(path)) return 1;
    calls++;
    if (log_fd >= 0) {
        char line[5000];
        int size = snprintf(line, sizeof line, "%s %s\n", name, path);
        if (!write_it) write_it = dlsym(RTLD_NEXT, "write");
        write_it(log_fd, line, size);
    }
    if (calls != armed_at) return 1;
    if (fault == -1) kill(getpid(), SIGKILL);
    errno = fault;
    return 0;
}

static int allowed_fd(const char *name, int fd) {
    char link[64], path[4096];
    if (!under[0] || fd == log_fd) return 1;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t size = readlink(link, path, sizeof path - 1);
    if (size <= 0) return 1;
    path[size] = 0;
    return allowed(name, path);
}

#define REAL(type, name, ...) \
    static type (*real)(__VA_ARGS__); \
    if (!real) real = dlsym(RTLD_NEXT, #name);

ssize_t write(int fd, const void *data, size_t size) {
    REAL(ssize_t, write, int, const void *, size_t)
    return allowed_fd("write", fd) ? real(fd, data, size) : -1;
}
ssize_t writev(int fd, const struct iovec *parts, int count) {
    REAL(ssize_t, writev, int, const struct iovec *, int)
    return allowed_fd("write", fd) ? real(fd, parts, count) : -1;
}
ssize_t pwrite64(int fd, const void *data, size_t size, off64_t place) {
    REAL(ssize_t, pwrite64, int, const void *, size_t, off64_t)
    return allowed_fd("write", fd) ? real(fd, data, size, place) : -1;
}
int ftruncate64(int fd, off64_t size) {
    REAL(int, ftruncate64, int, off64_t)
    return allowed_fd("truncate", fd) ? real(fd, size) : -1;
}
int fsync(int fd) {
    REAL(int, fsync, int)
    return allowed_fd("fsync", fd) ? real(fd) : -1;
}
int fdatasync(int fd) {
    REAL(int, fdatasync, int)
    return allowed_fd("fsync", fd) ? real(fd) : -1;
}
int close(int fd) {
    REAL(int, close, int)
    /* A failing close has closed all the same. */
    if (allowed_fd("close", fd)) return real(fd);
    int reason = errno;
    real(fd);
    errno = reason;
    return -1;
}
static int opened(int (*real)(const char *, int, ...), const char *path, int flags, mode_t mode) {
    if ((flags & (O_CREAT | O_WRONLY | O_RDWR)) && !allowed("open", path)) return -1;
    return real(path, flags, mode);
}
int open(const char *path, int flags, ...) {
    REAL(int, open, const char *, int, ...)
    va_list more;
    va_start(more, flags);
    mode_t mode = flags & O_CREAT ? va_arg(more, mode_t) : 0;
    va_end(more);
    return opened(real, path, flags, mode);
}
int open64(const char *path, int flags, ...) {
    REAL(int, open64, const char *, int, ...)
    va_list more;
    va_start(more, flags);
    mode_t mode = flags & O_CREAT ? va_arg(more, mode_t) : 0;
    va_end(more);
    return opened(real, path, flags, mode);
}
int rename(const char *from, const char *to) {
    REAL(int, rename, const char *, const char *)
    return allowed("rename", from) ? real(from, to) : -1;
}
int link(const char *from, const char *to) {
    REAL(int, link, const char *, const char *)
    return allowed("link", from) ? real(from, to) : -1;
}
int linkat(int from_fd, const char *from, int to_fd, const char *to, int flags) {
    REAL(int, linkat, int, const char *, int, const char *, int)
    return allowed("link", from) ? real(from_fd, from, to_fd, to, flags) : -1;
}
int unlink(const char *path) {
    REAL(int, unlink, const char *)
    return allowed("unlink", path) ? real(path) : -1;
}
int unlinkat(int fd, const char *path, int flags) {
    REAL(int, unlinkat, int, const char *, int)
    if (path[0] == '/' ? !allowed("unlink", path) : !allowed_fd("unlink", fd)) return -1;
    return real(fd, path, flags);
}
int rmdir(const char *path) {
    REAL(int, rmdir, const char *)
    return allowed("unlink", path) ? real(path) : -1;
}
int mkdir(const char *path, mode_t mode) {
    REAL(int, mkdir, const char *, mode_t)
    return allowed("mkdir", path) ? real(path, mode) : -1;
}
