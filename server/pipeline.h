// SPDX-License-Identifier: GPL-3.0-or-later
//
// The program behind the interface: uploads become stored volumes, requests become jobs that run the stages of core/,
// and what they make is kept in the store. Implements what api/ asks for.
//
// A model's job: read -> boundary -> delaunay -> spheres -> store. An answer that is derived from a model (measures,
// checks, pictures, exports) is a job too, and its bytes are kept as they will be sent.
#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "api/service.h"
#include "server/access/auth.h"
#include "server/config.h"
#include "server/work/jobs.h"

namespace spherule::server {

/// What is to be logged; each may be empty. Called from many threads.
struct PipelineLogs {
  FaultLog fault;
  EndLog job_ended;
  /// Not used for longer than such things are kept, or an answer that made room for another.
  std::function<void(const std::string& id)> expired;
  std::function<void(const std::string& id)> damaged;  ///< a stored answer, which is made again
  std::function<void(const std::string& name)> aside;  ///< what was damaged or unknown, and is in damaged/ now
  /// The clock on the wall has moved by so much more than time was served: it was set, or no server ran.
  std::function<void(std::chrono::seconds by)> clock_moved;
};

class Pipeline final : public api::Service, private api::Replies {
 public:
  /// Opens the store in config.data (made if needed) and takes up the jobs that an earlier process left. Throws busy
  /// when another process uses that folder, and what Catalog and FileBlobStore throw.
  /// `more` gives what other parts of the process tell of themselves in metrics().
  using MetricSource = std::function<std::vector<api::Metric>()>;
  explicit Pipeline(const Config& config, PipelineLogs logs = {}, MetricSource more = {});
  ~Pipeline() override;

  /// The same pipeline for this client, whose turns its jobs take and whom they are counted for; it may cancel those of
  /// others with the scope admin only.
  Pipeline on_behalf_of(std::string client, Scope scope) const { return {state_, std::move(client), scope}; }

  /// Starts no more jobs, gives running ones `grace` to finish and then stops them; they run again at the next start.
  /// Ends every wait, and then what else requests have it do. False when a job does not hear: it runs on, and whoever
  /// destroys the pipeline waits for it.
  bool stop(std::chrono::milliseconds grace);

  api::About about() const override;
  api::Limits limits() const override;
  api::Readiness readiness() const override;
  std::unique_ptr<api::Upload> start_upload(std::uint64_t announced) override;
  api::Stored<api::VolumeInfo> store_volume(std::unique_ptr<api::Upload> upload,
                                            const api::VolumeParameters& parameters, const api::Gone& gone) override;
  api::Stored<api::ModelInfo> import_model(std::unique_ptr<api::Upload> upload, api::SphereFormat format) override;
  using Service::find;
  api::Thing find(api::Collection collection, const std::string& id) override;
  api::Page<api::Thing> list(api::Collection collection, const api::PageRequest& page) override;
  void remove(api::Collection collection, const std::string& id) override;
  api::Content content(const std::string& volume, std::size_t index) override;
  api::SpherePage spheres(const std::string& model, std::uint32_t level, std::uint64_t offset, std::size_t limit,
                          const api::SphereListing& listing, bool members) override;
  RadiusHistogram radius_histogram(const std::string& model, std::size_t buckets, RadiusScale scale) override;
  api::Outcome submit(const api::WorkRequest& request, Seconds wait) override;
  api::Page<api::JobInfo> jobs(const api::PageRequest& page) override;
  api::JobInfo job(const std::string& id) override;
  api::JobEvents job_events(const std::string& id, std::uint64_t after, Seconds wait) override;
  std::optional<api::JobInfo> cancel_job(const std::string& id) override;
  api::PartialUploads& partial_uploads() override;
  api::Replies& replies() override { return *this; }
  std::vector<api::Metric> metrics() override;

 private:
  struct State;
  Pipeline(std::shared_ptr<State> state, std::string client, Scope scope)
      : state_(std::move(state)), client_(std::move(client)), scope_(scope) {}

  std::optional<std::string> recall(const std::string& key) override;
  void keep(const std::string& key, const std::string& reply) override;
  void release(const std::string& key) override;
  std::string own(const std::string& key) const;
  api::DerivedRequest checked(api::DerivedRequest request);

  std::shared_ptr<State> state_;
  std::string client_;
  Scope scope_ = Scope::admin;
};

}  // namespace spherule::server
