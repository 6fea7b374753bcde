import * as ort from "onnxruntime-web/jspi";
import { serve } from "./serve";

serve(ort as never);
