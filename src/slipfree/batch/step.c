/* Steps of Ralston's third-order method, as `advance` and `candidate_lanes` of motion.py do them
 * without a compiler.
 * The macros are rows of the states and of the results of the graph "motion".
 *
 * `rates` are the derivatives at the states. After `counts` steps of length `h`, the positions are
 * predicted, not yet corrected. Lanes `from` to `to` of n are computed. The last row of `out` is 1 for lanes whose corrections stayed small.
 */
static void moved(vd *s, const vd *start, const vd *k, vd h) {
  for (int i = 0; i < MOVING; i++) s[i] = start[i] + h * k[i];
}

static vl corrected(vd *s, const vd *r, double most, double worst) {
  for (int i = 0; i < POSITIONS; i++) s[FIRST_POSITION + i] = r[NEW_POSITIONS + i];
  for (int i = 0; i < UNKNOWNS; i++) s[FIRST_UNKNOWN + i] = r[NEW_UNKNOWNS + i];
  return (r[CHANGE] < splat(most)) & (r[ERROR] <= splat(worst));
}

static inline int any(vl mask) {
  long long bits = 0;
  for (int l = 0; l < LANES; l++) bits |= mask[l];
  return bits != 0;
}

#ifdef LAG
/* The damping of two linearly implicit half steps is complete for infinitely stiff contacts. */
static vl stepped(vd *s, const vd *a, const vd *k1, vd h, vd *r, double most, double worst,
                  const double *K, const Cells *cells) {
  vd start[MOVING], half = SPLAT(0.5) * h, middle[MOVING];
  (void)k1; /* of another lag */
  memcpy(s, a, ROWS * sizeof *s);
  s[LAG] = half;
  eval_motion(s, r, K, cells, 1.0);
  vl good = corrected(s, r, most, worst);
  memcpy(start, s, sizeof start);
  moved(s, start, r, half);
  s[TIME] = a[TIME] + half;
  memcpy(middle, s, sizeof middle);
  eval_motion(s, r, K, cells, 1.0);
  good &= corrected(s, r, most, worst);
  moved(s, start, r, h);
  for (int i = FIRST_RELAXING; i < LAST_RELAXING; i++) s[i] = middle[i] + half * r[i];
  s[LAG] = SPLAT(0.0);
  s[TIME] = a[TIME] + h;
  return good;
}
#else
static vl stepped(vd *s, const vd *a, const vd *k1, vd h, vd *r, double most, double worst,
                  const double *K, const Cells *cells) {
  vd k2[MOVING];
  memcpy(s, a, ROWS * sizeof *s);
  moved(s, a, k1, SPLAT(0.5) * h);
  s[TIME] = a[TIME] + SPLAT(0.5) * h;
  eval_motion(s, r, K, cells, 1.0);
  vl good = corrected(s, r, most, worst);
  memcpy(k2, r, sizeof k2);
  moved(s, a, k2, SPLAT(0.75) * h);
  s[TIME] = a[TIME] + SPLAT(0.75) * h;
  eval_motion(s, r, K, cells, 1.0);
  good &= corrected(s, r, most, worst);
  for (int i = 0; i < MOVING; i++)
    s[i] = a[i] + (h / SPLAT(9.0)) * (SPLAT(2.0) * k1[i] + SPLAT(3.0) * k2[i] + SPLAT(4.0) * r[i]);
  s[TIME] = a[TIME] + h;
  return good;
}
#endif

void advance(long from, long to, long n, const double *in, long stride, const double *rates, const double *lengths,
             const double *counts, double most, double worst, double *out, const double *K, const Cells *cells) {
  vd a[ROWS], s[ROWS], r[RESULTS], k1[MOVING];
  for (long g = from; g < to; g += LANES) {
    vd h = load(lengths + g, n - g);
    vl good = ~(vl)SPLAT(0.0);
    for (int i = 0; i < ROWS; i++) a[i] = load(in + i * stride + g, n - g);
    for (int i = 0; i < MOVING; i++) k1[i] = load(rates + i * n + g, n - g);
    vd count = load(counts + g, n - g);
    double steps = count[0];
    for (int l = 1; l < LANES; l++) steps = fmax(steps, count[l]);
    for (double step = 0; step < steps; step++) {
      vl done = count <= splat(step);
      memcpy(s, a, sizeof s);
      if (step) {
        eval_motion(s, r, K, cells, 1.0);
        good &= corrected(s, r, most, worst) | done;
        memcpy(k1, r, sizeof k1);
        for (int i = 0; i < ROWS; i++) a[i] = pick(done, a[i], s[i]);
      }
      good &= stepped(s, a, k1, h, r, most, worst, K, cells) | done;
      for (int i = 0; i < ROWS; i++) a[i] = pick(done, a[i], s[i]);
    }
    for (int i = 0; i < ROWS; i++) store(out + i * n + g, a[i], n - g);
    store(out + ROWS * n + g, truth(good), n - g);
  }
}

/* Correct a state by the graph "checked": k is the derivative; return which lanes are solved.
 *
 * Forces near a limit may need further Newton steps; other lanes keep their values.
 */
static vl checked_at(vd *a, vd *k, vd *r, double most, double worst, double repeats, const double *K, const Cells *cells) {
  vd more[CHECKED_RESULTS];
  eval_checked(a, r, K, cells, 1.0);
  vl good = corrected(a, r, most, worst);
  memcpy(k, r, MOVING * sizeof *k);
  for (int i = 0; i < FORCES; i++) a[FIRST_FORCE + i] = r[NEW_FORCES + i];
  for (double j = 0; j < repeats; j++) {
    vl rough = good & ~(r[DOUBT] <= SPLAT(0.0));
    if (!any(rough)) break;
    eval_checked(a, more, K, cells, 1.0);
    for (int i = NEW_FORCES; i < CHECKED_RESULTS; i++) r[i] = pick(rough, more[i], r[i]);
    for (int i = 0; i < FORCES; i++) a[FIRST_FORCE + i] = r[NEW_FORCES + i];
  }
  return good;
}

/* Time and reason of the ends of lanes: -1 complete, -2 not solved, or the index of a bound. */
typedef struct { vd time, reason; } Ends;

/* End those of the lanes that are solved beyond a limit; return the others. */
static vl inside(vl lanes, vl solved, const vd *r, vd time, double rounding, Ends *ends) {
  vd least = SPLAT(INFINITY), bound = SPLAT(0.0);
  for (int i = FIRST_DISTANCE; i < CHECKED_RESULTS; i++) {
    vl less = (r[i] < least) | (r[i] != r[i]);
    least = pick(less, r[i], least);
    bound = pick(less, splat(i - FIRST_DISTANCE), bound);
  }
  vl beyond = lanes & solved & ~(least >= splat(-rounding));
  ends->time = pick(beyond, time, ends->time);
  ends->reason = pick(beyond, bound, ends->reason);
  return lanes & ~beyond;
}

/* Motions over m samples: rows that are integrated at the samples (m, MOVING, n), and ends (2, n).
 *
 * An interval in which a lane is not solved begins once more in shorter steps.
 */
void drive(long from, long to, long n, const double *in, const double *inputs, long m, const double *t, double length,
           double longest, double most, double worst, double rounding, double repeats, double tries,
           double finer, double *samples, double *out, const double *K, const Cells *cells) {
  vd a[ROWS], b[ROWS], s[ROWS], r[CHECKED_RESULTS], rates[MOVING], first[MOVING], k1[MOVING];
  vd nothing = SPLAT(0.0) / SPLAT(0.0), speed = SPLAT(0.0);
  for (long g = from; g < to; g += LANES) {
    vl every = ~(vl)SPLAT(0.0), alive = every;
    Ends ends = {splat(t[m - 1]), SPLAT(-1.0)};
    for (int i = 0; i < ROWS; i++) b[i] = load(in + i * n + g, n - g);
    memcpy(a, b, sizeof a);
    for (long k = 0; k < m; k++) { /* from sample k - 1 to sample k */
      double span = k ? t[k] - t[k - 1] : 0.0;
      vd count = vmin(vmax(vceil(speed * splat(span / length) - SPLAT(1e-9)), SPLAT(1.0)), splat(longest));
      vl open = alive;
      memcpy(b, a, sizeof b);
      memcpy(first, rates, sizeof first);
      for (double attempt = 0; attempt < (k ? tries : 1) && any(open); attempt++) {
        vl going = open, arrived = open, lost = ~every;
        double steps = 0;
        if (k)
          for (int l = 0; l < LANES; l++) steps = open[l] ? fmax(steps, count[l]) : steps;
        for (int i = 0; i < ROWS; i++) a[i] = pick(open, b[i], a[i]);
        memcpy(k1, first, sizeof k1);
        for (double step = 0; step < steps && any(going); step++) {
          memcpy(s, a, sizeof s);
          if (step) {
            vl solved = checked_at(s, k1, r, most, worst, repeats, K, cells);
            going = inside(going, solved, r, a[TIME], rounding, &ends);
            lost |= going & ~solved;
            going &= solved;
            for (int i = 0; i < ROWS; i++) a[i] = pick(going, s[i], a[i]);
          }
          vl solved = stepped(s, a, k1, splat(span) / count, r, most, worst, K, cells);
          lost |= going & ~solved;
          going &= solved;
          for (int i = 0; i < ROWS; i++) a[i] = pick(going, s[i], a[i]);
          going &= count > splat(step + 1);
        }
        arrived &= ~lost & (ends.reason == SPLAT(-1.0));
        memcpy(s, a, sizeof s);
        s[TIME] = splat(t[k]);
        if (k < m - 1)
          for (int i = 0; i < INPUTS; i++) s[FIRST_INPUT + i] = load(inputs + (i * (m - 1) + k) * n + g, n - g);
        vl solved = checked_at(s, k1, r, most, worst, repeats, K, cells);
        arrived = inside(arrived, solved, r, s[TIME], rounding, &ends);
        lost |= arrived & ~solved;
        arrived &= solved;
        for (int i = 0; i < ROWS; i++) a[i] = pick(arrived, s[i], a[i]);
        for (int i = 0; i < MOVING; i++) rates[i] = pick(arrived, k1[i], rates[i]);
        speed = pick(arrived, r[SPEED], speed);
        count = pick(lost, count * splat(finer), count);
        open = lost;
      }
      ends.time = pick(open, splat(t[k ? k - 1 : 0]), ends.time);
      ends.reason = pick(open, SPLAT(-2.0), ends.reason);
      alive = ends.reason == SPLAT(-1.0);
      for (int i = 0; i < MOVING; i++) store(samples + (k * MOVING + i) * n + g, pick(alive, a[i], nothing), n - g);
    }
    store(out + g, ends.time, n - g);
    store(out + n + g, ends.reason, n - g);
  }
}
