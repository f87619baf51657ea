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

struct FloatPatch {
  std::array<float, 3> min, max;
  std::uint32_t ball;
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
  std::span<const Sphere> spheres;
  std::vector<FloatPatch> patches;
  Vec3 centre;  // Embree's coordinates are relative to it, where single precision is finest
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

  static const Sphere& ball_of(const void* user, unsigned primitive, std::uint32_t& index) {
    const auto& scene = *static_cast<const Scene*>(user);
    index = scene.patches[primitive].ball;
    return scene.spheres[index];
  }

  static void bounds(const RTCBoundsFunctionArguments* arguments) {
    const FloatPatch& patch = static_cast<const Scene*>(arguments->geometryUserPtr)->patches[arguments->primID];
    *arguments->bounds_o = {patch.min[0], patch.min[1], patch.min[2], 0, patch.max[0], patch.max[1], patch.max[2], 0};
  }

  static void intersect(const RTCIntersectFunctionNArguments* arguments) {
    if (arguments->valid[0] == 0) return;
    auto& query = *reinterpret_cast<Query*>(arguments->context);
    std::uint32_t index = 0;
    const Sphere& ball = ball_of(arguments->geometryUserPtr, arguments->primID, index);
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
    std::uint32_t index = 0;
    const Sphere& ball = ball_of(arguments->geometryUserPtr, arguments->primID, index);
    if (std::isfinite(entry(query.ray, ball))) reinterpret_cast<RTCRay*>(arguments->ray)->tfar = -kInfinity;
  }

  static bool keep_building(void* context, double) {
    return !static_cast<const Context*>(context)->cancel.stop_requested();
  }
};

Tracer::Tracer(std::span<const Sphere> spheres, std::span<const Patch> patches, const Context& context) {
  auto made = std::make_unique<Scene>();
  made->spheres = spheres;
  Box all;
  for (const Patch& patch : patches) all.include(patch.box.min), all.include(patch.box.max);
  made->centre = 0.5 * (all.min + all.max);
  // Boxes grow by more than single precision can lose on the way of a ray through the scene.
  const Vec3 extent = all.max - all.min;
  const double slack = 2e-6 * std::max({extent.x, extent.y, extent.z});
  made->patches.reserve(patches.size());
  for (const Patch& patch : patches) {
    FloatPatch& small = made->patches.emplace_back();
    for (int a = 0; a < 3; ++a) {
      small.min[static_cast<std::size_t>(a)] = static_cast<float>(patch.box.min[a] - made->centre[a] - slack);
      small.max[static_cast<std::size_t>(a)] = static_cast<float>(patch.box.max[a] - made->centre[a] + slack);
    }
    small.ball = patch.ball;
  }

  made->device.reset(rtcNewDevice(("threads=" + std::to_string(std::max(1U, context.threads))).c_str()));
  if (!made->device) throw std::bad_alloc();
  made->scene.reset(rtcNewScene(made->device.get()));
  rtcSetSceneFlags(made->scene.get(), RTC_SCENE_FLAG_ROBUST);
  RTCGeometry geometry = rtcNewGeometry(made->device.get(), RTC_GEOMETRY_TYPE_USER);
  rtcSetGeometryUserPrimitiveCount(geometry, static_cast<unsigned>(made->patches.size()));
  rtcSetGeometryUserData(geometry, made.get());
  rtcSetGeometryBoundsFunction(
      geometry, [](const RTCBoundsFunctionArguments* a) { Scene::bounds(a); }, nullptr);
  rtcSetGeometryIntersectFunction(geometry, [](const RTCIntersectFunctionNArguments* a) { Scene::intersect(a); });
  rtcSetGeometryOccludedFunction(geometry, [](const RTCOccludedFunctionNArguments* a) { Scene::occluded(a); });
  rtcCommitGeometry(geometry);
  rtcAttachGeometry(made->scene.get(), geometry);
  rtcReleaseGeometry(geometry);
  rtcSetSceneProgressMonitorFunction(made->scene.get(), &Scene::keep_building, const_cast<Context*>(&context));
  rtcCommitScene(made->scene.get());
  rtcSetSceneProgressMonitorFunction(made->scene.get(), nullptr, nullptr);
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
