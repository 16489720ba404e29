/* Client of "tissue serve" in C: moves a tool down and prints the force on it.
 *
 * cc -O2 -o pose_client examples/clients/pose_client.c -lm && ./pose_client [PORT] [STEPS]
 *
 * POSIX sockets and a little-endian machine. Lengths are in m, in the frame of the scene.
 */
#include <arpa/inet.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

enum { HELLO = 1, POSE = 2, WRENCH = 3, HEARTBEAT = 4, BYE = 5, REFUSED = 6 };
enum { HEADER = 24, CHECK = 4, MOST = 2048 };

static int line;
static uint32_t sent, seen;

static double now_s(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return t.tv_sec + 1e-9 * t.tv_nsec;
}

/* CRC-32 of IEEE 802.3, bit by bit: 140 bytes take about 2 us. */
static uint32_t crc32(const uint8_t *data, size_t length) {
  uint32_t crc = 0xffffffffu;
  for (size_t i = 0; i < length; i++) {
    crc ^= data[i];
    for (int bit = 0; bit < 8; bit++) crc = crc >> 1 ^ (crc & 1 ? 0xedb88320u : 0);
  }
  return ~crc;
}

static void send_packet(uint8_t kind, const void *payload, uint16_t length) {
  uint8_t data[MOST] = {'T', 'D', 'E', 'V', 1, kind};
  double clock = now_s();
  memcpy(data + 6, &length, 2);
  memcpy(data + 8, &sent, 4);
  memcpy(data + 12, &seen, 4);
  memcpy(data + 16, &clock, 8);
  memcpy(data + HEADER, payload, length);
  uint32_t check = crc32(data, HEADER + length);
  memcpy(data + HEADER + length, &check, 4);
  send(line, data, HEADER + length + CHECK, 0);
}

/* Send a packet and wait for its answer; return 0 if none comes within 0.1 s. */
static int ask(uint8_t kind, const void *payload, uint16_t length, uint8_t wanted, void *answer,
               size_t size) {
  uint8_t data[MOST];
  sent++;
  send_packet(kind, payload, length);
  for (;;) {
    ssize_t got = recv(line, data, sizeof data, 0);
    if (got < HEADER + CHECK) return 0;
    uint32_t check, number, echo;
    memcpy(&check, data + got - CHECK, 4);
    memcpy(&number, data + 8, 4);
    memcpy(&echo, data + 12, 4);
    if (memcmp(data, "TDEV\x01", 5) || check != crc32(data, got - CHECK)) continue;
    if (data[5] == REFUSED) {
      fprintf(stderr, "%.*s\n", (int)(got - HEADER - CHECK), (char *)data + HEADER);
      exit(1);
    }
    seen = number;
    /* The echo is the number of the packet that an answer belongs to. */
    if (data[5] == wanted && echo == sent && got - HEADER - CHECK == (ssize_t)size) {
      memcpy(answer, data + HEADER, size);
      return 1;
    }
  }
}

/* Move the tool to a tip [m], upright; write force [N] and torque about the tip [N m]. */
static void move_to(double x, double y, double z, double wrench[6]) {
  struct {
    double tip[3], quaternion[4], velocity[3], spin[3];
    uint32_t buttons, zero;
  } pose = {{x, y, z}, {0, 0, 0, 1}, {0}, {0}, 0, 0};
  while (!ask(POSE, &pose, sizeof pose, WRENCH, wrench, 48)) {
  }
}

static int by_size(const void *a, const void *b) {
  double x = *(const double *)a, y = *(const double *)b;
  return (x > y) - (x < y);
}

int main(int count, char **words) {
  int port = count > 1 ? atoi(words[1]) : 24930, steps = count > 2 ? atoi(words[2]) : 2000;
  struct sockaddr_in place = {.sin_family = AF_INET, .sin_port = htons(port)};
  struct timeval longest = {0, 100000};
  double wrench[6], largest = 0.0, *times = malloc(steps * sizeof *times);
  inet_pton(AF_INET, "127.0.0.1", &place.sin_addr);
  line = socket(AF_INET, SOCK_DGRAM, 0);
  connect(line, (struct sockaddr *)&place, sizeof place);
  setsockopt(line, SOL_SOCKET, SO_RCVTIMEO, &longest, sizeof longest);
  for (int tries = 0; !ask(HELLO, "", 0, HELLO, wrench, 0); tries++) {
    if (tries == 0) fprintf(stderr, "no server answers at 127.0.0.1:%d yet\n", port);
    usleep(100000);
  }
  for (int step = 0; step < steps; step++) { /* 2 mm/s at steps of 1 ms */
    double start = now_s();
    move_to(0.0, 0.0, 1e-3 - 2e-6 * step, wrench);
    times[step] = now_s() - start;
    if (wrench[2] > largest) largest = wrench[2];
  }
  sent++;
  send_packet(BYE, "", 0);
  qsort(times, steps, sizeof *times, by_size);
  printf("largest force %.2f N; round trip %.0f us, 99 %% below %.0f us\n", largest,
         1e6 * times[steps / 2], 1e6 * times[steps * 99 / 100]);
  return 0;
}
