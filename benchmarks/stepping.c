/* The step of fig6 (two masses, exact linear flow, modified Hertz kick on mass 2) in plain C: the
   yardstick of benchmarks/montecarlo.py, which compiles and runs it where there is a compiler.
   The same arithmetic as sim/random.py and sim/parts/linear.py, 128 lanes a block.

       stepping BLOCKS STEPS REPEATS  <  4 x 8 matrix, h, clearance, stiffness, shift
       prints: median and fastest ns per particle-step of CPU time, E q2^2 of the last states. */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define W 128
#define GOLDEN 0x9E3779B97F4A7C15ULL
typedef uint32_t u32;
typedef uint64_t u64;

static float as_float(u32 u) { float f; memcpy(&f, &u, 4); return f; }
static u32 as_bits(float f) { u32 u; memcpy(&u, &f, 4); return u; }

static double seconds(void) {
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}

static void fill_words(u64 *restrict words, u64 first) {
    for (int k = 0; k < W; k++) {
        u64 z = first + (u64)k * (GOLDEN << 40);
        z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ULL;
        z = (z ^ (z >> 27)) * 0x94D049BB133111EBULL;
        words[k] = z ^ (z >> 31);
    }
}

static void box_muller(float *restrict rows, const u32 *restrict halves) {
    for (int k = 0; k < W; k++) {
        u32 a = halves[W + k];
        u32 bits = as_bits((float)(halves[k] | 1u)) - 0x4F3504F3u;
        float e = (float)(int)(bits & 0xFF800000u);
        float f = as_float((bits & 0x7FFFFFu) + 0x3F3504F3u) - 1.0f;
        float log = -0.397971302f + f * (0.344940275f + f * (-0.324683785f + f * 0.202681139f));
        log = f * (-1.99999988f + f * (1.00000727f + f * (-0.666702271f + f * (0.49940142f + f * log))));
        float r = sqrtf(log - 1.6525917e-7f * e);
        r = as_float(as_bits(r) | (a & 0x80000000u));
        float x = as_float((a & 0x7FFFFFu) | 0x40000000u) - 3.0f, y = x * x;
        rows[W + k] = r * (x * (1.57079518f + y * (-0.64592582f + y * (0.079500325f + y * -0.00437080022f))));
        rows[k] = r * (0.99999994f + y * (-1.23369825f + y * (0.253650695f + y * (-0.0208105706f + y * 0.00085816253f))));
    }
}

static void kick_and_map(double *x, const float *z, const double *m, double h, double clearance,
                         double B, double shift) {
#pragma GCC ivdep
    for (int k = 0; k < W; k++) {
        double q1 = x[k], q2 = x[W + k], p1 = x[2 * W + k], p2 = x[3 * W + k];
        double o = fabs(q2) - clearance;
        o = o > 0.0 ? o : 0.0;
        double root = sqrt(o);
        p2 -= h * copysign(B, q2) * (o * root) * (1.0 - shift * (1.5 * B * root));
        double a = z[k], b = z[W + k], c = z[2 * W + k], d = z[3 * W + k];
        x[k] = m[0] * q1 + m[1] * q2 + m[2] * p1 + m[3] * p2 + m[4] * a;
        x[W + k] = m[8] * q1 + m[9] * q2 + m[10] * p1 + m[11] * p2 + m[12] * a + m[13] * b;
        x[2 * W + k] = m[16] * q1 + m[17] * q2 + m[18] * p1 + m[19] * p2 + m[20] * a + m[21] * b
                       + m[22] * c;
        x[3 * W + k] = m[24] * q1 + m[25] * q2 + m[26] * p1 + m[27] * p2 + m[28] * a + m[29] * b
                       + m[30] * c + m[31] * d;
    }
}

static int rising(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

int main(int count, char **words_of) {
    int blocks = atoi(words_of[1]), steps = atoi(words_of[2]), repeats = atoi(words_of[3]);
    double m[32], rest[4], ns[1000], square = 0.0;
    for (int i = 0; i < 36; i++)
        if (scanf("%lf", i < 32 ? &m[i] : &rest[i - 32]) != 1) return 1;
    double *x = aligned_alloc(64, (size_t)blocks * 4 * W * sizeof(double));
    u64 *words = aligned_alloc(64, W * sizeof(u64));
    float *z = aligned_alloc(64, 4 * W * sizeof(float));
    u32 *halves = aligned_alloc(64, 2 * W * sizeof(u32));
    memset(x, 0, (size_t)blocks * 4 * W * sizeof(double));
    for (int r = 0; r < repeats && r < 1000; r++) {
        double start = seconds();
        for (int b = 0; b < blocks; b++)
            for (int t = 0; t < steps; t++) {
                for (int pair = 0; pair < 2; pair++) {
                    u64 word = ((u64)b * W << 40) + 2 * ((u64)r * steps + t) + pair;
                    fill_words(words, word * GOLDEN);
                    memcpy(halves, words, W * sizeof(u64));
                    box_muller(z + 2 * pair * W, halves);
                }
                kick_and_map(x + 4 * W * b, z, m, rest[0], rest[1], rest[2], rest[3]);
            }
        ns[r] = 1e9 * (seconds() - start) / ((double)blocks * W * steps);
    }
    for (int b = 0; b < blocks; b++)
        for (int k = 0; k < W; k++) square += pow(x[4 * W * b + W + k], 2) / (blocks * W);
    qsort(ns, repeats, sizeof(double), rising);
    printf("%.4f %.4f %.6f\n", ns[repeats / 2], ns[0], square);
    return 0;
}
