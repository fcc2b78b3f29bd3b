// Embree 4 in packets, one thread, on geometry and rays that our benchmarks write. Never a dependency of the crate.
//
// The library comes in PyPI's `embreex`, which brings no headers: what is used of them is declared below.
//
//     python3 -m venv rival && rival/bin/pip install embreex
//     LIBS=$(echo $PWD/rival/lib/python3*/site-packages/embreex.libs)
//     cc -std=c11 -O3 -march=native -o embree_rival tests/bench/embree_rival.c -Wl,-rpath,$LIBS $LIBS/* -lm
//
//     SURFLUX_BENCH_DATA=FOLDER cargo bench --bench rays
//     ./embree_rival rays FOLDER
//     SURFLUX_EMBREE=./embree_rival cargo bench --bench visibility -- STAGE
//
// `rays FOLDER` traces the rays there in packets of 1 (no packet), 4, 8 and 16, with the hint that they are coherent
// and without, robust and not, and prints millions of rays a second of processor time, the median of RUNS runs that are
// interleaved; the rays are in packets already when the clock starts. It fails if more than MOST_DIFFERENT of the rays
// are told otherwise than we told them.
//
// `visibility FOLDER SET N...` sees what each receiver of SET sees of the sky along directions that all share, a packet
// of neighbors along one direction after the other, and prints what it cost.
#define _POSIX_C_SOURCE 200809L
#include <math.h>
#include <pmmintrin.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

/* Of Embree 4's interface. */
typedef struct RTCDeviceTy *RTCDevice;
typedef struct RTCSceneTy *RTCScene;
typedef struct RTCGeometryTy *RTCGeometry;
struct RTCIntersectArguments {
    int flags;
    unsigned feature_mask;
    void *context, *filter, *function;
    float reserved[4];
};
RTCDevice rtcNewDevice(const char *config);
ssize_t rtcGetDeviceProperty(RTCDevice, int property);
int rtcGetDeviceError(RTCDevice);
RTCScene rtcNewScene(RTCDevice);
void rtcSetSceneFlags(RTCScene, int flags);
void rtcSetSceneBuildQuality(RTCScene, int quality);
void rtcCommitScene(RTCScene);
void rtcReleaseScene(RTCScene);
RTCGeometry rtcNewGeometry(RTCDevice, int type);
void *rtcSetNewGeometryBuffer(RTCGeometry, int type, unsigned slot, int format, size_t stride, size_t count);
void rtcCommitGeometry(RTCGeometry);
unsigned rtcAttachGeometry(RTCScene, RTCGeometry);
void rtcReleaseGeometry(RTCGeometry);
void rtcOccluded1(RTCScene, void *, struct RTCIntersectArguments *);
void rtcOccluded4(const int *valid, RTCScene, void *, struct RTCIntersectArguments *);
void rtcOccluded8(const int *valid, RTCScene, void *, struct RTCIntersectArguments *);
void rtcOccluded16(const int *valid, RTCScene, void *, struct RTCIntersectArguments *);
void rtcIntersect1(RTCScene, void *, struct RTCIntersectArguments *);
void rtcIntersect4(const int *valid, RTCScene, void *, struct RTCIntersectArguments *);
void rtcIntersect8(const int *valid, RTCScene, void *, struct RTCIntersectArguments *);
void rtcIntersect16(const int *valid, RTCScene, void *, struct RTCIntersectArguments *);
enum { VERSION_PROPERTY = 0, TRIANGLES = 0, INDICES = 0, VERTICES = 1, UINT3 = 0x5003, FLOAT3 = 0x9003 };
enum { ROBUST = 1 << 2, COHERENT = 1 << 16, MEDIUM = 1, NO_HIT = -1 };

/* A packet is a table of rows of `width` values: the ray's, then the hit's; spare rows for versions with instances. */
enum { ORIGIN = 0, NEAR = 3, DIRECTION = 4, TIME = 7, FAR = 8, MASK = 9, FLAGS = 11, GEOMETRY = 18, ROWS = 24 };
enum { WIDEST = 16, RUNS = 7 };

static const int WIDTHS[] = {1, 4, 8, 16};
enum { WIDTH_COUNT = 4 };

/* Edges that Embree misses when it is not robust and rays that graze: share of the rays. */
static const double MOST_DIFFERENT = 1e-4;
/* Distances to the same triangle, relative. */
static const float SAME_DISTANCE = 1e-3f;

static void fail(const char *what, const char *where)
{
    fprintf(stderr, "embree_rival: %s %s\n", what, where);
    exit(1);
}

static double seconds(void)
{
    struct timespec now;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static FILE *open_file(const char *folder, const char *name, const char *mode)
{
    char path[4096];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    FILE *file = fopen(path, mode);
    if (!file)
        fail("cannot open", path);
    return file;
}

/* Little-endian floats of FOLDER/NAME, and how many vectors of `size` they are. */
static float *load(const char *folder, const char *name, size_t size, size_t *count)
{
    FILE *file = open_file(folder, name, "rb");
    fseek(file, 0, SEEK_END);
    size_t bytes = (size_t)ftell(file);
    rewind(file);
    float *values = malloc(bytes + 1);
    if (fread(values, 1, bytes, file) != bytes || bytes % (4 * size) != 0)
        fail("cut off:", name);
    fclose(file);
    *count = bytes / (4 * size);
    return values;
}

static RTCDevice new_device(void)
{
    RTCDevice device = rtcNewDevice("threads=1,user_threads=1");
    if (!device)
        fail("no device:", "Embree");
    _MM_SET_FLUSH_ZERO_MODE(_MM_FLUSH_ZERO_ON);
    _MM_SET_DENORMALS_ZERO_MODE(_MM_DENORMALS_ZERO_ON);
    return device;
}

/* Triangles of three corners each, not shared. Medium quality: rays are as fast with high, which takes longer. */
static RTCScene new_scene(RTCDevice device, const float *corners, size_t triangles, int flags)
{
    RTCGeometry mesh = rtcNewGeometry(device, TRIANGLES);
    float *vertices = rtcSetNewGeometryBuffer(mesh, VERTICES, 0, FLOAT3, 12, 3 * triangles);
    unsigned *indices = rtcSetNewGeometryBuffer(mesh, INDICES, 0, UINT3, 12, triangles);
    memcpy(vertices, corners, 36 * triangles);
    for (size_t i = 0; i < 3 * triangles; i++)
        indices[i] = (unsigned)i;
    rtcCommitGeometry(mesh);
    RTCScene scene = rtcNewScene(device);
    rtcSetSceneFlags(scene, flags);
    rtcSetSceneBuildQuality(scene, MEDIUM);
    rtcAttachGeometry(scene, mesh);
    rtcReleaseGeometry(mesh);
    rtcCommitScene(scene);
    if (rtcGetDeviceError(device))
        fail("the scene is not built:", "Embree");
    return scene;
}

static struct RTCIntersectArguments hints(bool coherent)
{
    return (struct RTCIntersectArguments){.flags = coherent ? COHERENT : 0, .feature_mask = ~0u};
}

typedef enum { OCCLUDED, CLOSEST } Query;

static void trace(Query query, int width, const int *valid, RTCScene scene, float *packet, struct RTCIntersectArguments *hints)
{
    switch (query == OCCLUDED ? width : -width) {
    case 1: rtcOccluded1(scene, packet, hints); break;
    case 4: rtcOccluded4(valid, scene, packet, hints); break;
    case 8: rtcOccluded8(valid, scene, packet, hints); break;
    case 16: rtcOccluded16(valid, scene, packet, hints); break;
    case -1: rtcIntersect1(scene, packet, hints); break;
    case -4: rtcIntersect4(valid, scene, packet, hints); break;
    case -8: rtcIntersect8(valid, scene, packet, hints); break;
    case -16: rtcIntersect16(valid, scene, packet, hints); break;
    }
}

static float *new_packets(size_t count, int width)
{
    size_t bytes = (count * ROWS * (size_t)width * 4 + 63) / 64 * 64;
    float *packets = aligned_alloc(64, bytes);
    memset(packets, 0, bytes);
    for (size_t i = 0; i < count; i++)
        memset(packets + (i * ROWS + MASK) * (size_t)width, 0xff, 4 * (size_t)width);
    return packets;
}

/* ---- rays ---- */

/* Rays of one file, as we found them. */
typedef struct {
    size_t count;
    float *rays;     /* origin, direction */
    float *distance; /* infinite where nothing is hit */
} Rays;

/* The same in packets of consecutive ones. */
static float *packed(const Rays *rays, int width)
{
    size_t count = (rays->count + (size_t)width - 1) / (size_t)width;
    float *packets = new_packets(count, width);
    for (size_t i = 0; i < rays->count; i++) {
        float *lane = packets + i / (size_t)width * ROWS * (size_t)width + i % (size_t)width;
        for (int axis = 0; axis < 3; axis++) {
            lane[(ORIGIN + axis) * width] = rays->rays[6 * i + (size_t)axis];
            lane[(DIRECTION + axis) * width] = rays->rays[6 * i + 3 + (size_t)axis];
        }
    }
    return packets;
}

static bool is_hit(Query query, int width, const float *lane)
{
    int geometry;
    memcpy(&geometry, lane + GEOMETRY * width, 4);
    return query == OCCLUDED ? lane[FAR * width] < 0.0f : geometry != NO_HIT;
}

/* All of them, once; seconds. */
static double trace_all(Query query, int width, RTCScene scene, float *packets, size_t count, bool coherent)
{
    struct RTCIntersectArguments arguments = hints(coherent);
    double start = seconds();
    for (size_t first = 0; first < count; first += (size_t)width, packets += ROWS * width) {
        int valid[WIDEST];
        for (int i = 0; i < width; i++) {
            valid[i] = first + (size_t)i < count ? -1 : 0;
            packets[FAR * width + i] = INFINITY;
        }
        if (query == CLOSEST)
            memset(packets + GEOMETRY * width, 0xff, 4 * (size_t)width);
        trace(query, width, valid, scene, packets, &arguments);
    }
    return seconds() - start;
}

/* Rays that were told otherwise than we told them; adds to `hits`. */
static size_t different(Query query, int width, const float *packets, const Rays *rays, size_t *hits)
{
    size_t count = 0;
    for (size_t i = 0; i < rays->count; i++) {
        const float *lane = packets + i / (size_t)width * ROWS * (size_t)width + i % (size_t)width;
        bool hit = is_hit(query, width, lane);
        float ours = rays->distance[i];
        bool same = hit == isfinite(ours);
        if (same && hit && query == CLOSEST)
            same = fabsf(lane[FAR * width] - ours) <= SAME_DISTANCE * ours;
        *hits += hit;
        count += !same;
    }
    return count;
}

static int ascending(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* One line: median speed of each width with the better hint, hits and differences of the last; false if too many. */
static bool compare(Query query, const char *order, RTCScene scene, const Rays *rays)
{
    double times[WIDTH_COUNT][2][RUNS];
    float *packets[WIDTH_COUNT];
    for (int w = 0; w < WIDTH_COUNT; w++)
        packets[w] = packed(rays, WIDTHS[w]);
    for (int run = 0; run < RUNS; run++)
        for (int w = 0; w < WIDTH_COUNT; w++)
            for (int coherent = 0; coherent < 2; coherent++)
                times[w][coherent][run] = trace_all(query, WIDTHS[w], scene, packets[w], rays->count, coherent);
    printf("  %-8s %-5s", query == OCCLUDED ? "occluded" : "closest", order);
    size_t hits = 0, worst = 0;
    for (int w = 0; w < WIDTH_COUNT; w++) {
        double best = INFINITY;
        for (int coherent = 0; coherent < 2; coherent++) {
            qsort(times[w][coherent], RUNS, sizeof(double), ascending);
            best = fmin(best, times[w][coherent][RUNS / 2]);
        }
        printf("  %2d: %6.2f", WIDTHS[w], 1e-6 * (double)rays->count / best);
        hits = 0;
        size_t differing = different(query, WIDTHS[w], packets[w], rays, &hits);
        worst = differing > worst ? differing : worst;
        free(packets[w]);
    }
    printf("  Mray/s, %zu of %zu hit, at most %zu differ\n", hits, rays->count, worst);
    return (double)worst <= MOST_DIFFERENT * (double)rays->count;
}

static bool compare_shape(RTCDevice device, const char *folder, const char *shape)
{
    static const char *orders[] = {"local", "world"};
    char name[256];
    size_t triangles, count;
    snprintf(name, sizeof name, "%s_triangles.f32", shape);
    float *corners = load(folder, name, 9, &triangles);
    bool same = true;
    for (int robust = 0; robust < 2; robust++) {
        double start = seconds();
        RTCScene scene = new_scene(device, corners, triangles, robust ? ROBUST : 0);
        printf("%s%s: %zu triangles, built in %.3f s\n", shape, robust ? ", robust" : "", triangles, seconds() - start);
        for (int order = 0; order < 2; order++) {
            Rays rays;
            snprintf(name, sizeof name, "%s_%s_rays.f32", shape, orders[order]);
            rays.rays = load(folder, name, 6, &rays.count);
            snprintf(name, sizeof name, "%s_%s_distances.f32", shape, orders[order]);
            rays.distance = load(folder, name, 1, &count);
            if (count != rays.count)
                fail("does not match its rays:", name);
            same &= compare(OCCLUDED, orders[order], scene, &rays);
            same &= compare(CLOSEST, orders[order], scene, &rays);
            free(rays.rays);
            free(rays.distance);
        }
        rtcReleaseScene(scene);
    }
    free(corners);
    return same;
}

/* ---- visibility ---- */

typedef struct {
    size_t receivers, directions;
    const float *receiver;  /* lifted origin, normal */
    const float *direction; /* evenly over the sphere */
    RTCScene scene;
} Look;

/* What `width` receivers see, 0…1. One that has fewer neighbors left than the packet has lanes stands there several
   times. */
static inline __attribute__((always_inline)) void see(const Look *look, size_t first, int width, bool coherent, float *seen)
{
    _Alignas(64) float packet[ROWS * WIDEST];
    _Alignas(64) float normal[3][WIDEST], weight[WIDEST] = {0}, open[WIDEST] = {0};
    _Alignas(64) int valid[WIDEST];
    struct RTCIntersectArguments arguments = hints(coherent);
    memset(packet, 0, sizeof packet);
    memset(packet + MASK * width, 0xff, 4 * (size_t)width);
    for (int i = 0; i < width; i++) {
        size_t place = first + (size_t)i < look->receivers ? first + (size_t)i : look->receivers - 1;
        for (int axis = 0; axis < 3; axis++) {
            packet[(ORIGIN + axis) * width + i] = look->receiver[6 * place + (size_t)axis];
            normal[axis][i] = look->receiver[6 * place + 3 + (size_t)axis];
        }
    }
    for (size_t d = 0; d < look->directions; d++) {
        const float *way = look->direction + 3 * d;
        float cosine[WIDEST];
        int any = 0;
        for (int i = 0; i < width; i++) {
            float x = normal[0][i] * way[0] + normal[1][i] * way[1] + normal[2][i] * way[2];
            cosine[i] = x > 0.0f ? x : 0.0f;
            valid[i] = x > 0.0f ? -1 : 0;
            any |= valid[i];
            packet[DIRECTION * width + i] = way[0];
            packet[(DIRECTION + 1) * width + i] = way[1];
            packet[(DIRECTION + 2) * width + i] = way[2];
            packet[FAR * width + i] = INFINITY;
        }
        if (!any)
            continue;
        trace(OCCLUDED, width, valid, look->scene, packet, &arguments);
        for (int i = 0; i < width; i++) {
            weight[i] += cosine[i];
            open[i] += packet[FAR * width + i] < 0.0f ? 0.0f : cosine[i];
        }
    }
    for (int i = 0; i < width; i++)
        seen[i] = open[i] / weight[i];
}

/* Every `step`th group of WIDEST receivers; seconds. */
static double see_all(const Look *look, int width, bool coherent, size_t step, float *seen)
{
    double start = seconds();
    for (size_t group = 0; group < look->receivers; group += step * WIDEST)
        for (size_t first = group; first < group + WIDEST && first < look->receivers; first += (size_t)width)
            switch (width) {
            case 1: see(look, first, 1, coherent, seen + first); break;
            case 4: see(look, first, 4, coherent, seen + first); break;
            case 8: see(look, first, 8, coherent, seen + first); break;
            case 16: see(look, first, 16, coherent, seen + first); break;
            }
    return seconds() - start;
}

/* The fastest packets, on a sixty-fourth of the receivers. */
static int fastest(const Look *look, bool *coherent, float *seen)
{
    int width = 0;
    double least = INFINITY;
    for (int w = 0; w < WIDTH_COUNT; w++)
        for (int hint = 0; hint < 2; hint++) {
            double cost = see_all(look, WIDTHS[w], hint, 64, seen);
            if (cost < least) {
                least = cost;
                width = WIDTHS[w];
                *coherent = hint;
            }
        }
    return width;
}

/* Reads triangles.f32, SET_receivers.f32 and SET_directions_N.f32, writes SET_visibility_N.f32. Prints the seconds that
   the scene took, then for each N the width of the packets, what is said of them, and the seconds. */
static void visibility(RTCDevice device, const char *folder, const char *set, int argc, char **argv)
{
    char name[256];
    size_t triangles;
    float *corners = load(folder, "triangles.f32", 9, &triangles);
    double start = seconds();
    Look look = {.scene = new_scene(device, corners, triangles, 0)};
    printf("%.6f\n", seconds() - start);
    snprintf(name, sizeof name, "%s_receivers.f32", set);
    look.receiver = load(folder, name, 6, &look.receivers);
    float *seen = malloc(4 * (look.receivers + WIDEST));
    for (int i = 0; i < argc; i++) {
        snprintf(name, sizeof name, "%s_directions_%s.f32", set, argv[i]);
        look.direction = load(folder, name, 3, &look.directions);
        bool coherent = false;
        int width = fastest(&look, &coherent, seen);
        double cost = see_all(&look, width, coherent, 1, seen);
        printf("%d %s %.6f\n", width, coherent ? "coherent" : "incoherent", cost);
        snprintf(name, sizeof name, "%s_visibility_%s.f32", set, argv[i]);
        FILE *file = open_file(folder, name, "wb");
        if (fwrite(seen, 4, look.receivers, file) != look.receivers || fclose(file))
            fail("cannot write", name);
    }
}

int main(int argc, char **argv)
{
    RTCDevice device = new_device();
    if (argc == 3 && !strcmp(argv[1], "rays")) {
        ssize_t version = rtcGetDeviceProperty(device, VERSION_PROPERTY);
        printf("Embree %d.%d.%d\n", (int)(version / 10000), (int)(version / 100 % 100), (int)(version % 100));
        bool box = compare_shape(device, argv[2], "box"), ball = compare_shape(device, argv[2], "ball");
        return box && ball ? 0 : 1;
    }
    if (argc > 4 && !strcmp(argv[1], "visibility")) {
        visibility(device, argv[2], argv[3], argc - 4, argv + 4);
        return 0;
    }
    fail("usage: rays FOLDER | visibility FOLDER SET N...", "");
}
