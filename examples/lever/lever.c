/* A lever in C: drives an actuator of an esair robot, with zenoh-pico and nothing else.
 *
 *     lever tcp/127.0.0.1:7447 base speed 0.3 5
 *
 * writes 0.3 to the actuator "speed" of the robot "base", 20 times a second for 5 seconds,
 * and prints how each write was answered. base has to share it: [share.speed] to = ["lever"].
 * The messages are those of docs/reference/network.md; numbers are little endian, as here.
 */
#include <pthread.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>
#include <zenoh-pico.h>

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static uint64_t run, beat, its_run, its_beat; /* of this program, and of the robot */
static double heard_at;
static long written, refused;
static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec + t.tv_nsec / 1e9;
}

/* Every message of the robot tells its newest beat: it is what a command has to echo. */
static void hear(z_loaned_sample_t *sample, void *unused) {
    (void)unused;
    uint8_t data[256];
    z_bytes_reader_t reader = z_bytes_get_reader(z_sample_payload(sample));
    size_t size = z_bytes_reader_read(&reader, data, sizeof data);
    uint64_t head[2];
    if (size < 40) return;
    memcpy(head, data, sizeof head);
    pthread_mutex_lock(&lock);
    if (head[0] != its_run || head[1] > its_beat)
        its_run = head[0], its_beat = head[1], heard_at = now();
    /* An answer: version, tuple of 3, whole number, short text. */
    if (size >= 64 && data[41] == 't' && data[46] == 'i' && data[55] == 's') {
        *(data[56] == 7 && !memcmp(data + 57, "written", 7) ? &written : &refused) += 1;
    }
    pthread_mutex_unlock(&lock);
}

static void say(const z_loaned_session_t *session, const char *robot, const char *what,
                const uint8_t *body, size_t size) {
    uint8_t data[256];
    char key[160];
    pthread_mutex_lock(&lock);
    uint64_t head[4] = {run, beat, its_run, its_beat};
    double held = its_run ? now() - heard_at : 0.0;
    pthread_mutex_unlock(&lock);
    memcpy(data, head, 32), memcpy(data + 32, &held, 8);
    if (size) memcpy(data + 40, body, size);
    snprintf(key, sizeof key, "esair/1/%s/lever/%s", robot, what);
    z_view_keyexpr_t to;
    z_owned_bytes_t payload;
    z_view_keyexpr_from_str(&to, key);
    z_bytes_copy_from_buf(&payload, data, 40 + size);
    z_put(session, z_loan(to), z_move(payload), NULL);
}

int main(int argc, char **argv) {
    if (argc != 6 || strlen(argv[2]) > 63 || strlen(argv[3]) > 63) return 2;
    const char *robot = argv[2], *actuator = argv[3];
    double value = atof(argv[4]), end = now() + atof(argv[5]);
    char key[160];
    z_owned_config_t config;
    z_owned_session_t session;
    z_owned_closure_sample_t hears;
    z_view_keyexpr_t from;
    run = (uint64_t)time(NULL) << 20 | (uint64_t)getpid();
    z_config_default(&config);
    zp_config_insert(z_loan_mut(config), Z_CONFIG_MODE_KEY, "client");
    zp_config_insert(z_loan_mut(config), Z_CONFIG_CONNECT_KEY, argv[1]);
    if (z_open(&session, z_move(config), NULL) < 0) return 1;
    zp_start_read_task(z_loan_mut(session), NULL);
    zp_start_lease_task(z_loan_mut(session), NULL);
    z_closure(&hears, hear, NULL, NULL);
    snprintf(key, sizeof key, "esair/1/lever/%s/*", robot);
    z_view_keyexpr_from_str(&from, key);
    z_declare_background_subscriber(z_loan(session), z_loan(from), z_move(hears), NULL);
    for (uint64_t number = 1; now() < end; number++, usleep(50000)) {
        uint8_t body[96] = {1, 't', 3, 0, 0, 0, 'i'}, *at = body + 15;
        beat = number;
        memcpy(body + 7, &number, 8);
        *at++ = 's', *at++ = strlen(actuator);
        at = (uint8_t *)memcpy(at, actuator, strlen(actuator)) + strlen(actuator);
        *at++ = 'f', memcpy(at, &value, 8);
        say(z_loan(session), robot, "beat", NULL, 0);
        if (its_run) say(z_loan(session), robot, "write", body, at + 8 - body);
    }
    say(z_loan(session), robot, "bye", NULL, 0);
    z_drop(z_move(session));
    printf("written %ld, refused %ld\n", written, refused);
    return written ? 0 : 1;
}
