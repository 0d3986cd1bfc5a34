/* Test of @name@.c against slipfree @version@: returns 0 if all numbers agree within 1e-12.
 *
 * A difference is relative to the number, or to 1 if that is larger. The first half of the places
 * are on level ground, the others on a map. */
#include "@name@.h"

#include <math.h>
#include <stdio.h>
#include <time.h>

#define TOLERANCE 1e-12
#define CASES @n_cases@
#define LEVEL @n_level@
#define N_X @n_x@
#define N_Y @n_y@
#define REPEATS 20

static const double heights[N_X * N_Y] = {
@heights@
};
static const @name@_place places[CASES] = {
@places@
};
static const @name@_pose poses[CASES] = {
@poses@
};
static const @name@_command commands[CASES] = {
@commands@
};
static const @name@_rates answers[CASES] = {
@answers@
};

/* The largest difference of two records of n numbers; infinite if one is not a number. */
static double difference(const void *computed, const void *expected, size_t n) {
  const double *a = (const double *)computed, *b = (const double *)expected;
  double largest = 0;
  size_t k;
  for (k = 0; k < n; k++) {
    double d = fabs(a[k] - b[k]) / fmax(1, fabs(b[k]));
    if (!(d <= largest)) largest = d == d ? d : HUGE_VAL;
  }
  return largest;
}

int main(void) {
  static double coefficients[(N_X + 2) * (N_Y + 2)];
  @name@_ground map;
  const size_t n_pose = sizeof(@name@_pose) / sizeof(double);
  const size_t n_rates = sizeof(@name@_rates) / sizeof(double);
  double largest = 0, settling, inverting;
  int failures = 0, k, repeat;
  clock_t start;
  if (@name@_map(&map, heights, N_X, N_Y, @map@, coefficients)) failures++;
  for (k = 0; k < CASES; k++) {
    const @name@_ground *ground = k < LEVEL ? NULL : &map;
    @name@_pose guessed, moved = poses[k];
    @name@_rates rates;
    @name@_guess(ground, &places[k], &guessed);
    moved.z += 0.01;
    if (@name@_settle(ground, &places[k], &guessed)) failures++;
    if (@name@_settle(ground, &places[k], &moved)) failures++;
    if (@name@_inverse(ground, &places[k], &guessed, &commands[k], &rates)) failures++;
    largest = fmax(largest, difference(&guessed, &poses[k], n_pose));
    largest = fmax(largest, difference(&moved, &poses[k], n_pose));
    largest = fmax(largest, difference(&rates, &answers[k], n_rates));
  }
  start = clock();
  for (repeat = 0; repeat < REPEATS; repeat++)
    for (k = 0; k < CASES; k++) {
      @name@_pose moved = poses[k];
      moved.z += 0.01;
      failures += @name@_settle(k < LEVEL ? NULL : &map, &places[k], &moved) != 0;
    }
  settling = (double)(clock() - start) / CLOCKS_PER_SEC;
  start = clock();
  for (repeat = 0; repeat < REPEATS; repeat++)
    for (k = 0; k < CASES; k++) {
      @name@_rates rates;
      failures += @name@_inverse(k < LEVEL ? NULL : &map, &places[k], &poses[k], &commands[k], &rates) != 0;
    }
  inverting = (double)(clock() - start) / CLOCKS_PER_SEC;
  printf("@name@: %d states, %d failures, largest difference %.1e\n", CASES, failures, largest);
  printf("@name@_settle: %.1f us, @name@_inverse: %.1f us\n", 1e6 * settling / (REPEATS * CASES),
      1e6 * inverting / (REPEATS * CASES));
  return failures || !(largest <= TOLERANCE);
}
