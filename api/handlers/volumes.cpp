// SPDX-License-Identifier: GPL-3.0-or-later
#include <cmath>

#include "api/handlers/handlers.h"
#include "api/json/documents.h"
#include "api/requests.h"

namespace spherule::api {

Response list_volumes(const Call& call) { return listed(call, "/v1/volumes", &Service::volumes, volume_list_document); }

namespace {

// A volume of files that were uploaded in pieces.
StoredVolume store_uploads(const Call& call, const std::vector<std::string>& ids, const VolumeParameters& parameters) {
  if (call.request.body != nullptr && call.request.body->present()) {
    throw Error(ErrorCode::invalid_argument, "Send no body beside ?upload=: the bytes are here already.");
  }
  std::uint64_t bytes = 0;
  for (const std::string& id : ids) bytes += call.service.upload(id).length;
  std::unique_ptr<Upload> upload = call.service.start_upload(bytes);
  for (const std::string& id : ids) {
    upload->begin_file(call.service.upload(id).filename);
    call.service.read_upload(id, [&](std::string_view piece) { upload->write(piece); });
  }
  StoredVolume stored = call.service.store_volume(std::move(upload), parameters, call.request.gone);
  // What could not be read stays, to be tried with other parameters.
  for (const std::string& id : ids) call.service.delete_upload(id);
  return stored;
}

}  // namespace

Response post_volume(const Call& call) {
  const VolumeParameters parameters = volume_parameters(call.request);
  const auto answer = [&](const StoredVolume& stored) {
    Response response = json_response(call, stored_volume_document(stored), stored.already_stored ? 200 : 201);
    response.set("Location", "/v1/volumes/" + stored.volume.id);
    return response;
  };
  if (const std::vector<std::string> ids = upload_ids(call.request); !ids.empty()) {
    return answer(store_uploads(call, ids, parameters));
  }
  Body* body = call.request.body;
  if (body == nullptr || !body->present()) {
    throw Error(ErrorCode::invalid_argument, "Send the bytes of a volume as the body.");
  }
  std::unique_ptr<Upload> upload = call.service.start_upload(body->announced());
  const std::uint64_t limit = call.service.limits().upload_bytes;
  const auto take = [&](std::string_view piece) { upload->write(piece); };
  if (media_type(call.request.header("Content-Type")) == "multipart/form-data") {
    body->read_parts(
        limit,
        [&](std::string_view name, std::string_view filename) {
          if (name != "file") {
            throw Error(ErrorCode::invalid_argument, "Name every part of the form \"file\".");
          }
          if (!is_utf8(filename)) throw Error(ErrorCode::invalid_argument, "Name the files in UTF-8.");
          upload->begin_file(filename);
        },
        take);
  } else {
    upload->begin_file({});
    body->read(limit, take);
  }
  return answer(call.service.store_volume(std::move(upload), parameters, call.request.gone));
}

Response get_volume(const Call& call) {
  const Query query(call.request, {});
  return json_response(call, volume_document(call.service.volume(call.id())));
}

Response delete_volume(const Call& call) {
  const Query query(call.request, {});
  call.service.delete_volume(call.id());
  return {.status = 204};
}

Response get_volume_content(const Call& call) {
  const Query query(call.request, {"file"});
  const auto index = static_cast<std::size_t>(query.integer("file", ranges::index).value_or(0));
  // As what it is would be a guess, and a page of somebody else's making must never run as ours.
  return content_response(call, call.service.volume_content(call.id(), index), "application/octet-stream",
                          call.id() + "-" + std::to_string(index));
}

Response get_volume_histogram(const Call& call) {
  const Query query(call.request, {"buckets", "plot", "mark", "format", "width", "height"});
  const auto wanted = query.integer("buckets", ranges::buckets);
  const FigureFormat format = plot_format(call, query);
  const PlotSize size = plot_size(call, query);
  const auto kind = query.choice("plot", {"values", "sizes"});
  const auto mark = query.numbers("mark", 1, ranges::value);
  if (format == FigureFormat::json && (kind || mark)) {
    throw Error(ErrorCode::invalid_argument, "Correct the parameters listed under errors.",
                {{kind ? "plot" : "mark", "This is for a plot: format=png or svg."}});
  }
  const VolumeInfo volume = call.service.volume(call.id());
  // A plot of few whole numbers has a bar for each: else some bars would hold two of them, or none.
  const double values = (volume.range.max - volume.range.min) / std::abs(volume.slope) + 1;
  const bool whole = volume.type < VoxelType::float32 && values <= 512 && format != FigureFormat::json;
  const auto buckets = static_cast<std::size_t>(wanted.value_or(whole ? std::llround(values) : 256));
  const auto plot = [&](const std::vector<std::uint64_t>& counts) {
    const Vec3 step = volume.grid.spacing;
    Plot drawn = kind == "sizes" ? plot_of_thresholds(volume.range, counts, step.x * step.y * step.z)
                                 : plot_of_values(volume.range, counts);
    if (mark) drawn.marks.push_back({mark->front()});
    return drawn;
  };
  const Wait wait = agreed_wait(call, true);
  const auto outcome = call.service.value_histogram(call.id(), buckets, wait.granted);
  const auto* counts = std::get_if<std::vector<std::uint64_t>>(&outcome);
  Response response = counts == nullptr              ? accepted(std::get<JobInfo>(outcome))
                      : format == FigureFormat::json ? json_response(call, value_histogram_document(volume, *counts))
                                                     : plotted(plot(*counts), format, size);
  wait.state(response, outcome);
  return response;
}

}  // namespace spherule::api
