// SPDX-License-Identifier: GPL-3.0-or-later
#include <cmath>

#include "api/handlers/handlers.h"
#include "api/handlers/parameters.h"
#include "api/http/negotiation.h"
#include "api/http/query.h"
#include "api/json/documents.h"
#include "api/json/records.h"

namespace spherule::api {

namespace {

// A volume of files that were uploaded in pieces.
Stored<VolumeInfo> store_uploads(const Call& call, const std::vector<std::string>& ids,
                                 const VolumeParameters& parameters) {
  if (call.request.body != nullptr && call.request.body->present()) {
    throw Error(ErrorCode::invalid_argument, "Send no body beside ?upload=: the bytes are here already.");
  }
  std::uint64_t bytes = 0;
  for (const std::string& id : ids) bytes += call.service.partial_uploads().find(id).length;
  std::unique_ptr<Upload> upload = call.service.start_upload(bytes);
  for (const std::string& id : ids) {
    upload->begin_file(call.service.partial_uploads().find(id).filename);
    call.service.partial_uploads().read(id, [&](std::string_view piece) { upload->write(piece); });
  }
  Stored<VolumeInfo> stored = call.service.store_volume(std::move(upload), parameters, call.request.gone);
  // What could not be read stays, to be tried with other parameters.
  for (const std::string& id : ids) call.service.partial_uploads().remove(id);
  return stored;
}

}  // namespace

Response post_volume(const Call& call) {
  const VolumeParameters parameters = volume_parameters(call.request);
  const auto answer = [&](const Stored<VolumeInfo>& volume) {
    return stored(call, stored_volume_document(volume), volume.already_stored, "/v1/volumes/" + volume.thing.id);
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

Response get_volume_content(const Call& call) {
  const Query query(call.request, {"file"});
  const auto index = static_cast<std::size_t>(query.integer("file", ranges::index).value_or(0));
  // As what it is would be a guess, and a page of somebody else's making must never run as ours.
  return content_response(call, call.service.content(call.id(), index), "application/octet-stream",
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
  const VolumeInfo volume = call.service.find<VolumeInfo>(call.id());
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
  const DerivedRequest request{.source = call.id(), .what = ValuesRequest{buckets}};
  return worked(call, request, agreed_wait(call, true), [&](const Made& made) {
    const std::vector<std::uint64_t> counts = counts_from(text_of(std::get<Content>(made)));
    return format == FigureFormat::json ? json_response(call, value_histogram_document(volume, counts))
                                        : plotted(plot(counts), format, size);
  });
}

}  // namespace spherule::api
