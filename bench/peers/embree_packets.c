/* Depth images by Embree 4, packets of coherent rays, one thread.
 *
 * The wheel that brings Embree's library has no headers and casts its rays one by one; this file declares the few
 * functions of Embree's public interface that it needs and casts them in packets of sixteen, which is what Embree is
 * fastest with. Built by `setup`, called from embree.py.
 */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

typedef void *RTCDevice;
typedef void *RTCScene;
typedef void *RTCGeometry;

enum { GEOMETRY_TRIANGLE = 0, GEOMETRY_INSTANCE = 121, FORMAT_ROWS = 0x9134, BUFFER_INDEX = 0, BUFFER_VERTEX = 1, FORMAT_UINT3 = 0x5003, FORMAT_FLOAT3 = 0x9003 };
enum { SCENE_DYNAMIC = 1 << 0, SCENE_ROBUST = 1 << 2, BUILD_QUALITY_LOW = 0, BUILD_QUALITY_HIGH = 2, RAY_COHERENT = 1 << 16 };
#define FEATURES_ALL 0xffffffffu
#define NO_GEOMETRY 0xffffffffu

extern RTCDevice rtcNewDevice(const char *config);
extern int rtcGetDeviceError(RTCDevice device);
extern RTCScene rtcNewScene(RTCDevice device);
extern void rtcSetSceneFlags(RTCScene scene, int flags);
extern void rtcSetSceneBuildQuality(RTCScene scene, int quality);
extern RTCGeometry rtcNewGeometry(RTCDevice device, int type);
extern void *rtcSetNewGeometryBuffer(RTCGeometry geometry, int type, unsigned slot, int format, size_t stride,
                                     size_t count);
extern void rtcSetGeometryInstancedScene(RTCGeometry geometry, RTCScene scene);
extern void rtcSetGeometryTransform(RTCGeometry geometry, unsigned time_step, int format, const void *transform);
extern RTCGeometry rtcGetGeometry(RTCScene scene, unsigned number);
extern void rtcCommitGeometry(RTCGeometry geometry);
extern unsigned rtcAttachGeometry(RTCScene scene, RTCGeometry geometry);
extern void rtcReleaseGeometry(RTCGeometry geometry);
extern void rtcCommitScene(RTCScene scene);
extern void rtcReleaseScene(RTCScene scene);

struct IntersectArguments {
    int flags;
    unsigned feature_mask;
    void *context;
    void *filter;
    void *intersect;
    float minimum_width;
};

/* Field order of RTCRayHit16; the tail is longer than any version's instance identifiers. */
struct __attribute__((aligned(64))) RayHit16 {
    float origin[3][16], near[16], direction[3][16], time[16], far[16];
    unsigned mask[16], id[16], flags[16];
    float normal[3][16], u[16], v[16];
    unsigned primitive[16], geometry[16], instance[8][16];
};

extern void rtcIntersect16(const int *valid, RTCScene scene, struct RayHit16 *rays, struct IntersectArguments *);

/* Embree's own words for "one thread, and not a second one in the pool". */
RTCDevice peers_device(void) { return rtcNewDevice("threads=1,user_threads=1,set_affinity=0"); }

static void attach_triangles(RTCDevice device, RTCScene scene, const float *triangles, unsigned count) {
    RTCGeometry geometry = rtcNewGeometry(device, GEOMETRY_TRIANGLE);
    float *vertices = rtcSetNewGeometryBuffer(geometry, BUFFER_VERTEX, 0, FORMAT_FLOAT3, 12, 3 * (size_t)count);
    unsigned *indices = rtcSetNewGeometryBuffer(geometry, BUFFER_INDEX, 0, FORMAT_UINT3, 12, count);
    memcpy(vertices, triangles, (size_t)count * 36);
    for (unsigned i = 0; i < 3 * count; ++i) indices[i] = i;
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(scene, geometry);
    rtcReleaseGeometry(geometry);
}

/* A scene of `count` triangles, nine numbers each. NULL if Embree reports an error. */
RTCScene peers_scene(RTCDevice device, const float *triangles, unsigned count, int robust) {
    RTCScene scene = rtcNewScene(device);
    rtcSetSceneFlags(scene, robust ? SCENE_ROBUST : 0);
    rtcSetSceneBuildQuality(scene, BUILD_QUALITY_HIGH);
    attach_triangles(device, scene, triangles, count);
    rtcCommitScene(scene);
    return rtcGetDeviceError(device) == 0 ? scene : NULL;
}

/* A scene whose bodies move: `fixed_count` triangles that stay, and `instances` scenes of one body each. */
RTCScene peers_moving_scene(RTCDevice device, const float *fixed, unsigned fixed_count, const RTCScene *instances,
                            unsigned instance_count) {
    RTCScene scene = rtcNewScene(device);
    rtcSetSceneFlags(scene, SCENE_DYNAMIC);
    rtcSetSceneBuildQuality(scene, BUILD_QUALITY_LOW);
    /* What is fixed is an instance that never moves: the tree above is rebuilt for each frame, that below is not. */
    for (unsigned i = 0; i <= instance_count; ++i) {
        RTCScene below = i < instance_count ? instances[i] : peers_scene(device, fixed, fixed_count, 0);
        RTCGeometry geometry = rtcNewGeometry(device, GEOMETRY_INSTANCE);
        rtcSetGeometryInstancedScene(geometry, below);
        rtcCommitGeometry(geometry);
        rtcAttachGeometry(scene, geometry);
        rtcReleaseGeometry(geometry);
        if (i == instance_count) rtcReleaseScene(below);
    }
    rtcCommitScene(scene);
    return rtcGetDeviceError(device) == 0 ? scene : NULL;
}

/* Moves the bodies of such a scene: three rows of four numbers each. */
void peers_move(RTCScene scene, const float *world_from_bodies, unsigned instance_count) {
    for (unsigned i = 0; i < instance_count; ++i) {
        RTCGeometry geometry = rtcGetGeometry(scene, i);
        rtcSetGeometryTransform(geometry, 0, FORMAT_ROWS, world_from_bodies + 12 * i);
        rtcCommitGeometry(geometry);
    }
    rtcCommitScene(scene);
}

void peers_release(RTCScene scene) { rtcReleaseScene(scene); }

/* Rays through pixel centres of a square image whose side is a multiple of 4, in tiles of 4 × 4.
 *
 * `axes` are the camera's right, up and ahead. Directions have length 1 along the camera's axis, so that the distance
 * Embree returns is the depth. Writes millimetres, rounded (0 = nothing hit), and, unless NULL, depth in metres, the
 * triangle's number, and whether it was hit from behind.
 */
void peers_depth(RTCScene scene, const float *origin, const float *axes, float tan_half, float near_m, int side,
                 uint16_t *depth_mm, float *depth_m, uint32_t *triangle, uint8_t *from_behind) {
    int valid[16];
    for (int lane = 0; lane < 16; ++lane) valid[lane] = -1;
    struct IntersectArguments arguments = {RAY_COHERENT, FEATURES_ALL, NULL, NULL, NULL, 0.0f};
    struct RayHit16 rays;
    memset(&rays, 0, sizeof rays);
    float slope = 2.0f * tan_half / (float)side;
    for (int top = 0; top < side; top += 4) {
        for (int left = 0; left < side; left += 4) {
            for (int lane = 0; lane < 16; ++lane) {
                float x = ((float)(left + lane % 4) + 0.5f) * slope - tan_half;
                float y = tan_half - ((float)(top + lane / 4) + 0.5f) * slope;
                for (int axis = 0; axis < 3; ++axis) {
                    rays.origin[axis][lane] = origin[axis];
                    rays.direction[axis][lane] = x * axes[axis] + y * axes[3 + axis] + axes[6 + axis];
                }
                rays.near[lane] = near_m;
                rays.far[lane] = INFINITY;
                rays.mask[lane] = ~0u;
                rays.geometry[lane] = NO_GEOMETRY;
                rays.instance[0][lane] = NO_GEOMETRY;
            }
            rtcIntersect16(valid, scene, &rays, &arguments);
            for (int lane = 0; lane < 16; ++lane) {
                size_t pixel = (size_t)(top + lane / 4) * (size_t)side + (size_t)(left + lane % 4);
                int hit = rays.geometry[lane] != NO_GEOMETRY;
                depth_mm[pixel] = hit ? (uint16_t)(rays.far[lane] * 1000.0f + 0.5f) : 0;
                if (depth_m) depth_m[pixel] = hit ? rays.far[lane] : 0.0f;
                if (triangle) triangle[pixel] = hit ? rays.primitive[lane] : NO_GEOMETRY;
                if (from_behind) {
                    float along = 0.0f;
                    for (int axis = 0; axis < 3; ++axis) {
                        along += rays.normal[axis][lane] * rays.direction[axis][lane];
                    }
                    from_behind[pixel] = hit && along > 0.0f;
                }
            }
        }
    }
}
