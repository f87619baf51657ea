// SPDX-License-Identifier: GPL-3.0-or-later
#include <array>

#include "api/handlers/handlers.h"
#include "api/handlers/parameters.h"
#include "api/http/negotiation.h"
#include "api/http/query.h"

namespace spherule::api {

Response get_slice(const Call& call) {
  const SliceRequest slice =
      slice_request(call.request, call.service.find<VolumeInfo>(call.id()), call.parameters[1], call.parameters[2]);
  check_pixels(call,
               static_cast<std::uint64_t>(slice.options.width) * static_cast<std::uint64_t>(slice.options.height));
  Response response = derived(call, {.source = call.id(), .what = slice}, media_type(slice.format));
  response.set("Vary", "Accept");
  return response;
}

void check_pixels(const Call& call, std::uint64_t pixels) {
  const std::uint64_t most = call.service.limits().image_pixels;
  if (pixels > most) {
    throw Error(ErrorCode::too_large, "Ask for pictures of at most " + std::to_string(most) + " pixels in all.");
  }
}

FigureFormat plot_format(const Call& call, const Query& query) {
  constexpr std::array kOrder{FigureFormat::json, FigureFormat::png, FigureFormat::svg};
  const FigureFormat format = figure_format(call.request, query, kOrder);
  for (const char* name : {"width", "height"}) {
    if (format == FigureFormat::json && query.text(name)) {
      throw Error(ErrorCode::invalid_argument, "Correct the parameters listed under errors.",
                  {{name, "This is for a plot: format=png or svg."}});
    }
  }
  return format;
}

PlotSize plot_size(const Call& call, const Query& query) {
  PlotSize size;
  size.width = static_cast<int>(query.integer("width", ranges::plot_pixels).value_or(size.width));
  size.height = static_cast<int>(query.integer("height", ranges::plot_pixels).value_or(size.height));
  check_pixels(call, static_cast<std::uint64_t>(size.width) * static_cast<std::uint64_t>(size.height));
  return size;
}

Response plotted(const Plot& plot, FigureFormat format, const PlotSize& size) {
  Response response{.status = 200,
                    .body = format == FigureFormat::png ? plot_to_png(plot, size.width, size.height)
                                                        : to_svg(draw_plot(plot, size.width, size.height))};
  response.set("Content-Type", std::string(media_type(format)));
  response.set("Vary", "Accept");
  return response;
}

}  // namespace spherule::api
