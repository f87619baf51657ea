// SPDX-License-Identifier: GPL-3.0-or-later
//
// Embree walks boxes in single precision; what a ray meets is computed here in double. Balls are user geometry: raw
// models have balls a thousand times as large as their visible patch, for which single precision gives ragged edges.
#include "core/render/trace.h"

#include <embree3/rtcore.h>

#include <cmath>
#include <limits>
#include <new>
#include <string>
#include <vector>

#include "core/base/check.h"

namespace spherule {
namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();

// A patch as rays need it: the ball itself, so that one look into memory answers.
struct Primitive {
  Sphere ball;
  std::uint32_t index;
};

struct DeviceDeleter {
  void operator()(RTCDevice device) const { rtcReleaseDevice(device); }
};
struct SceneDeleter {
  void operator()(RTCScene scene) const { rtcReleaseScene(scene); }
};
using Device = std::unique_ptr<std::remove_pointer_t<RTCDevice>, DeviceDeleter>;
using EmbreeScene = std::unique_ptr<std::remove_pointer_t<RTCScene>, SceneDeleter>;

// Embree hands its context back to the callbacks; what follows it in memory is ours.
struct Query {
  RTCIntersectContext context;
  Ray ray;
  double distance = std::numeric_limits<double>::infinity();
  std::uint32_t ball = std::numeric_limits<std::uint32_t>::max();
};

}  // namespace

struct Tracer::Scene {
  std::vector<Primitive> primitives;
  std::span<const Patch> patches;  // only while the hierarchy is built
  Vec3 centre;                     // Embree's coordinates are relative to it, where single precision is finest
  // Boxes grow by more than single precision can lose on the way of a ray through the scene.
  double slack = 0;
  Device device;
  EmbreeScene scene;

  RTCRay to_embree(const Ray& ray) const {
    const Vec3 origin = ray.origin - centre;
    RTCRay out{};
    out.org_x = static_cast<float>(origin.x);
    out.org_y = static_cast<float>(origin.y);
    out.org_z = static_cast<float>(origin.z);
    out.dir_x = static_cast<float>(ray.direction.x);
    out.dir_y = static_cast<float>(ray.direction.y);
    out.dir_z = static_cast<float>(ray.direction.z);
    out.tfar = kInfinity;
    out.mask = ~0U;
    return out;
  }

  // Where the ray enters the ball; infinity when it does not, or starts inside.
  static double entry(const Ray& ray, const Sphere& ball) {
    const Vec3 to_centre = ball.centre - ray.origin;
    const double along = dot(to_centre, ray.direction);
    // The distance of the centre from the ray by subtraction: no loss when the ball is large and far.
    const double squared_half_chord = ball.radius * ball.radius - squared_norm(to_centre - along * ray.direction);
    if (!(squared_half_chord > 0)) return std::numeric_limits<double>::infinity();
    const double distance = along - std::sqrt(squared_half_chord);
    return distance >= 0 ? distance : std::numeric_limits<double>::infinity();
  }

  static const Primitive& primitive_of(const void* user, unsigned index) {
    return static_cast<const Scene*>(user)->primitives[index];
  }

  static void bounds(const RTCBoundsFunctionArguments* arguments) {
    const auto& scene = *static_cast<const Scene*>(arguments->geometryUserPtr);
    const Box& box = scene.patches[arguments->primID].box;
    const Vec3 grow{scene.slack, scene.slack, scene.slack};
    const Vec3 min = box.min - scene.centre - grow, max = box.max - scene.centre + grow;
    *arguments->bounds_o = {static_cast<float>(min.x), static_cast<float>(min.y), static_cast<float>(min.z), 0,
                            static_cast<float>(max.x), static_cast<float>(max.y), static_cast<float>(max.z), 0};
  }

  static void intersect(const RTCIntersectFunctionNArguments* arguments) {
    if (arguments->valid[0] == 0) return;
    auto& query = *reinterpret_cast<Query*>(arguments->context);
    const auto& [ball, index] = primitive_of(arguments->geometryUserPtr, arguments->primID);
    const double distance = entry(query.ray, ball);
    if (distance > query.distance || (distance == query.distance && index >= query.ball)) return;
    query.distance = distance;
    query.ball = index;
    auto* hit = reinterpret_cast<RTCRayHit*>(arguments->rayhit);
    hit->ray.tfar = std::nextafter(static_cast<float>(distance), kInfinity);
    hit->hit.geomID = arguments->geomID;
    hit->hit.primID = arguments->primID;
  }

  static void occluded(const RTCOccludedFunctionNArguments* arguments) {
    if (arguments->valid[0] == 0) return;
    const auto& query = *reinterpret_cast<const Query*>(arguments->context);
    const Primitive& primitive = primitive_of(arguments->geometryUserPtr, arguments->primID);
    if (std::isfinite(entry(query.ray, primitive.ball))) reinterpret_cast<RTCRay*>(arguments->ray)->tfar = -kInfinity;
  }

  static bool keep_building(void* context, double) {
    return !static_cast<const Context*>(context)->cancel.stop_requested();
  }
};

Tracer::Tracer(std::span<const Sphere> spheres, std::span<const Patch> patches, const Context& context) {
  auto made = std::make_unique<Scene>();
  Box all;
  made->primitives.reserve(patches.size());
  for (const Patch& patch : patches) {
    all.include(patch.box.min), all.include(patch.box.max);
    made->primitives.push_back({spheres[patch.ball], patch.ball});
  }
  made->patches = patches;
  made->centre = 0.5 * (all.min + all.max);
  const Vec3 extent = all.max - all.min;
  made->slack = 2e-6 * std::max({extent.x, extent.y, extent.z});

  made->device.reset(rtcNewDevice(("threads=" + std::to_string(std::max(1U, context.threads))).c_str()));
  if (!made->device) throw std::bad_alloc();
  made->scene.reset(rtcNewScene(made->device.get()));
  RTCGeometry geometry = rtcNewGeometry(made->device.get(), RTC_GEOMETRY_TYPE_USER);
  rtcSetGeometryUserPrimitiveCount(geometry, static_cast<unsigned>(made->primitives.size()));
  rtcSetGeometryUserData(geometry, made.get());
  rtcSetGeometryBoundsFunction(geometry, &Scene::bounds, nullptr);
  rtcSetGeometryIntersectFunction(geometry, &Scene::intersect);
  rtcSetGeometryOccludedFunction(geometry, &Scene::occluded);
  rtcCommitGeometry(geometry);
  rtcAttachGeometry(made->scene.get(), geometry);
  rtcReleaseGeometry(geometry);
  rtcSetSceneProgressMonitorFunction(made->scene.get(), &Scene::keep_building, const_cast<Context*>(&context));
  rtcCommitScene(made->scene.get());
  rtcSetSceneProgressMonitorFunction(made->scene.get(), nullptr, nullptr);
  made->patches = {};
  context.throw_if_cancelled();
  const RTCError error = rtcGetDeviceError(made->device.get());
  if (error == RTC_ERROR_OUT_OF_MEMORY) throw std::bad_alloc();
  SPHERULE_CHECK(error == RTC_ERROR_NONE);
  scene_ = std::move(made);
}

Tracer::~Tracer() = default;

std::optional<Hit> Tracer::first_hit(const Ray& ray) const {
  Query query{{}, ray};
  rtcInitIntersectContext(&query.context);
  RTCRayHit hit{};
  hit.ray = scene_->to_embree(ray);
  hit.hit.geomID = RTC_INVALID_GEOMETRY_ID;
  rtcIntersect1(scene_->scene.get(), &query.context, &hit);
  if (!std::isfinite(query.distance)) return std::nullopt;
  return Hit{query.distance, query.ball};
}

bool Tracer::blocked(const Ray& ray) const {
  Query query{{}, ray};
  rtcInitIntersectContext(&query.context);
  RTCRay out = scene_->to_embree(ray);
  rtcOccluded1(scene_->scene.get(), &query.context, &out);
  return out.tfar < 0;
}

}  // namespace spherule
